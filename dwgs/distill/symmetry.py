"""What a vehicle looks like where no frame looks: as its other side does, in the same light.

Vehicles are mirror images of themselves about their plane y = 0; the light on them is not. So of what the frames show,
only that is mirrored which light does not explain (see `light`): how worn paint is, what points lack. Discs in these
colours are the *imagined* vehicle. The body begins as it, and while frames teach the body, imagined views from all
around hold what they do not see: their gradients count less the more pixels of frames show a Gaussian.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import KDTree
from torch import Tensor

from dwgs.distill.appearance import Appearance, look
from dwgs.distill.light import Light, find_light
from dwgs.distill.observe import pixels_shown
from dwgs.distill.shots import Shot
from dwgs.optimize import RetainedMse
from dwgs.scene import Camera, Gaussians, VehiclePoints
from dwgs.scene.color import linear_from_srgb, srgb_from_linear
from dwgs.scene.pose import pose
from dwgs.splat import Layers, RetainedCloud, Splats, View, render
from dwgs.splat.constants import SH_C0

LOOKS = 12
"""So many frames, spread over the clip, tell how the vehicle looks."""
MIRROR = np.array([1, -1, 1])
"""Left is right."""
NEIGHBOURS, NEAR = 8, 0.05
"""So many discs, near and mirrored, tell about one; those within this distance [m] alike."""
WITHIN = 0.1
"""A Gaussian this near [m] stands for the place of a mirror image."""
TURN, TINT = 0.2, 0.5
"""Distances [m] that stand for a right angle between normals and for other paint."""
VIEWS = 24
"""From so many sides the vehicle is imagined."""
ELEVATIONS = np.radians([4.0, 14.0, 28.0])
"""Of these views, in turn."""
WIDTH, HEIGHT = 224, 128
"""Of these views [px]."""
FILLED = 0.85
"""Share of the width that the vehicle's length fills."""
FAR = 2.0
"""Distance of these views, in lengths of the vehicle."""
GROUND = 0.5
"""Grey behind the imagined vehicle."""
OPACITY = 0.9
"""Of its discs."""
EVERY = 12
"""Steps from one imagined view to the next."""
UNSEEN = 0.006
"""This share of the pixels that frames show of a Gaussian on average halves what imagined views count for it."""
BLIND = 0.0005
"""One of which frames show a smaller share than this is never seen."""


@dataclass(frozen=True)
class Imagined:
    """A vehicle as it is thought to look, from all around."""

    body: Gaussians
    """Discs in the colours they are seen in, or thought to have."""
    pixels: NDArray[np.float64]
    """[body] how many pixels of a frame each begins to colour, on average."""
    views: tuple[View, ...]
    """From all around."""
    images: tuple[Tensor, ...]
    """[h, w, 3] what each shows, on grey."""


class Pull:
    """Imagined views of the cloud that a learner changes.

    Args:
        imagined: The views.
        cloud: The body's Gaussians, as many as imagined, then any others, which are left alone.
    """

    def __init__(self, imagined: Imagined, cloud: RetainedCloud) -> None:
        self._imagined, self._cloud = imagined, cloud
        layers = _grey_layers()
        self._pictures = [cloud.picture(view, layers) for view in imagined.views]
        self._losses: dict[int, tuple[object, RetainedMse]] = {}
        self._weight = torch.ones(HEIGHT, WIDTH)
        share = imagined.pixels / imagined.pixels.mean()
        weights = 1 / (1 + share / UNSEEN), share < BLIND
        self._early, self._late = (torch.from_numpy(weight.astype(np.float32)) for weight in weights)
        self._pulls: list[Tensor] = []

    def draw(self, turn: int, is_late: bool) -> None:
        """Find out where one view pulls the Gaussians: all that are hardly seen, later only those that never are."""
        k = turn % len(self._pictures)
        drawing = self._pictures[k].draw()
        if k not in self._losses or self._losses[k][0] is not drawing:
            self._losses[k] = drawing, RetainedMse(drawing.rgb, self._imagined.images[k], self._weight, drawing.v_rgb)
        self._losses[k][1]()
        drawing.v_depth.zero_()
        drawing.v_alpha.zero_()
        self._pictures[k].adjoint()
        weight = self._late if is_late else self._early
        self._pulls = [
            gradient[: len(weight)] * weight.view(-1, *[1] * (gradient.dim() - 1)) for gradient in self._cloud.gradients
        ]

    def add(self) -> None:
        """Add what `draw` found to the gradients that a frame left."""
        for gradient, pull in zip(self._cloud.gradients, self._pulls, strict=True):
            gradient[: len(pull)] += pull


def imagine(body: Gaussians, vehicle: VehiclePoints, shots: Sequence[Shot], threads: int) -> Imagined | None:
    """How the vehicle looks from all around; None where the frames show none of its discs.

    Args:
        body: Discs in the colours of the points, see `initialize_body`.
        vehicle: The points.
        shots: Frames that teach.
        threads: Frames looked at at once.
    """
    chosen = [shots[i] for i in np.unique(np.linspace(0, len(shots) - 1, min(LOOKS, len(shots))).astype(int))]
    pixels = np.mean(list(pixels_shown([(shot, shot.view, body) for shot in chosen], len(body), threads)), 0)
    appearance = look(body, chosen, vehicle.normals is not None, threads)
    if not appearance.is_seen.any():
        return None
    paints = np.clip(0.5 + SH_C0 * body.sh[:, 0], 0, 1)
    light = find_light(paints, appearance)
    colors = complete(body.means, paints, appearance, light)
    imagined = replace(body, opacities=np.full(len(body), OPACITY, np.float32))
    views, images = [], []
    length = float(np.ptp(body.means, axis=0).max())
    for k in range(VIEWS):
        view, eye = _view_around(2 * np.pi * ((k * 0.618034) % 1), ELEVATIONS[k % len(ELEVATIONS)], length)
        toward = eye - body.means
        cosines = np.abs((appearance.normals * toward).sum(1)) / np.linalg.norm(toward, axis=1)
        seen_so = colored(imagined, srgb_from_linear(linear_from_srgb(colors) + light.mirrored(cosines)))
        with torch.no_grad():
            image = render(Splats.from_gaussians(seen_so), view, _grey_layers(), threads=threads).rgb
        views.append(view)
        images.append(image.movedim(-1, 0).contiguous().movedim(0, -1))  # plane by plane, as pictures are stored
    return Imagined(colored(body, colors), pixels, tuple(views), tuple(images))


def complete(means: NDArray, paints: NDArray, appearance: Appearance, light: Light) -> NDArray[np.float64]:
    """Colours [N, 3] of all discs, seen from ahead.

    The light's, and what it does not explain: of a disc itself where frames show it, else that of the shown discs that
    lie, or whose mirror images lie, next to it, face as it does and are painted alike.
    """
    diffuse = light.diffuse(paints, appearance.normals)
    colors, seen = srgb_from_linear(diffuse), appearance.is_seen
    unexplained = appearance.colors[seen] - srgb_from_linear(diffuse[seen] + light.mirrored(appearance.cosines[seen]))
    features = np.hstack([means, TURN * appearance.normals, TINT * paints])
    images = np.hstack([means * MIRROR, TURN * appearance.normals * MIRROR, TINT * paints])
    shown = KDTree(np.concatenate([features[seen], images[seen]]))
    found = shown.query(features[~seen], min(NEIGHBOURS, shown.n))
    distances, near = (np.reshape(part, (np.count_nonzero(~seen), -1)) for part in found)
    near = near % np.count_nonzero(seen)
    weight = np.sqrt(appearance.pixels[seen])[near] / (distances**2 + NEAR**2)
    colors[seen] += unexplained
    colors[~seen] += (weight[..., None] * unexplained[near]).sum(1) / weight.sum(1, keepdims=True)
    return np.clip(colors, 0, 1)


def mirrored_share(body: Gaussians, observations: NDArray) -> float:
    """Share of the Gaussians that no frame saw, but whose mirror images lie where frames saw others."""
    seen = observations > 0
    if not seen.any():
        return 0.0
    distances = KDTree(body.means[seen]).query(body.means[~seen] * MIRROR)[0]
    return float((distances < WITHIN).sum() / len(body))


def colored(body: Gaussians, colors: NDArray) -> Gaussians:
    """The same in these colours [N, 3] from every side."""
    sh = np.zeros_like(body.sh)
    sh[:, 0] = (colors - 0.5) / SH_C0
    return replace(body, sh=sh)


def _view_around(azimuth: float, elevation: float, length: float) -> tuple[View, NDArray[np.float64]]:
    """A view of the vehicle from that side, and where it is seen from [3] [m]."""
    flat = np.cos(elevation)
    toward = np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0])
    eye = FAR * length * toward
    vehicle_from_camera = pose(np.stack([right, -np.cross(toward, right), -toward], 1), eye)
    focal = FILLED * FAR * WIDTH
    K = np.array([[focal, 0, WIDTH / 2], [0, focal, HEIGHT / 2], [0, 0, 1]])
    return View.from_camera(Camera(K, WIDTH, HEIGHT, vehicle_from_camera, 0.0), np.eye(4)), eye


def _grey_layers() -> Layers:
    grey = torch.full((HEIGHT, WIDTH, 3), GROUND)
    return Layers.of(None, (grey, torch.zeros(HEIGHT, WIDTH), torch.ones(HEIGHT, WIDTH)))
