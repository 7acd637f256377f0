"""What a vehicle looks like where no frame looks: as its other side does, in the same light.

Vehicles are mirror images of themselves about their plane y = 0; the light on them is not. So of what the frames show,
only that is mirrored which light does not explain (see `light`): how worn paint is, what points lack. The points in
these colours are the *imagined* vehicle. The body begins as it, and while frames teach the body, imagined views from
all around pull, too: so weakly that they count where frames say nothing.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import KDTree
from torch import Tensor

from dwgs.distill.appearance import Appearance, look
from dwgs.distill.lacquer import mirrored
from dwgs.distill.light import Light, find_light
from dwgs.distill.shots import Shot
from dwgs.optimize import RetainedMse
from dwgs.scene import Camera, Gaussians, VehiclePoints
from dwgs.scene.color import srgb_from_linear
from dwgs.scene.pose import pose
from dwgs.splat import Layers, RetainedCloud, Splats, View, render
from dwgs.splat.constants import SH_C0

LOOKS = 12
"""So many frames, spread over the clip, tell how the vehicle looks."""
MIRROR = np.array([1, -1, 1])
"""Left is right."""
NEIGHBOURS, NEAR = 8, 0.05
"""So many discs, near and mirrored, tell about one; those within this distance [m] alike."""
APART = 0.2
"""At this distance [m] from all that is shown, half of what light does not explain is that of all: the front is not as
the roof is seen from behind (0.24 dB from unseen sides)."""
WITHIN = 0.1
"""A Gaussian this near [m] stands for the place of a mirror image."""
TURN, TINT = 0.2, 0.5
"""Distances [m] that stand for a right angle between normals and for other paint."""
VIEWS = 24
"""From so many sides the vehicle is imagined."""
ELEVATIONS = np.radians([4.0, 14.0, 28.0])
"""Of these views, in turn."""
WIDTH, HEIGHT = 320, 184
"""Of these views [px]."""
FILLED = 0.85
"""Share of the width that the vehicle's length fills."""
FAR = 2.0
"""Distance of these views, in lengths of the vehicle."""
GROUND = 0.5
"""Grey behind the imagined vehicle."""
DENSE = 60_000
"""So many points of the vehicle at most are drawn in them: more and smaller than the body's discs, whose blur it
would learn ..."""
OPACITY = 0.9
"""... as discs of this opacity."""
EVERY = 24
"""Steps from one imagined view to the next."""
WEIGHT = 0.05
"""Of an imagined view beside a frame. Where no frame teaches any weight does, for Adam's steps do not know it; where
frames do, this costs them nothing that could be measured, a view every 12 steps with half the weight cost 0.05 dB."""


@dataclass(frozen=True)
class Imagined:
    """A vehicle as it is thought to look, from all around."""

    body: Gaussians
    """Discs in the colours they are seen in, or thought to have."""
    views: tuple[View, ...]
    """From all around."""
    images: tuple[Tensor, ...]
    """[h, w, 3] what each shows, on grey."""


@dataclass(frozen=True)
class Skin:
    """What a vehicle's surface is thought to be."""

    means: NDArray[np.float64]
    """[N, 3] where it is."""
    normals: NDArray[np.float64]
    """[N, 3]."""
    paints: NDArray[np.float64]
    """[N, 3] sRGB."""
    unexplained: NDArray[np.float64]
    """[N, 3] sRGB that light does not explain."""

    def __getitem__(self, index: NDArray) -> "Skin":
        return Skin(self.means[index], self.normals[index], self.paints[index], self.unexplained[index])

    def colors(self, light: Light, toward: NDArray) -> NDArray[np.float64]:
        """[N, 3] sRGB in which it is seen from the directions ``toward`` [N, 3]."""
        shown = light.shown(self.paints, self.normals, mirrored(self.normals, toward))
        return np.clip(srgb_from_linear(shown) + self.unexplained, 0, 1)


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
        self._pulls: list[Tensor] = []

    def draw(self, turn: int) -> None:
        """Find out where one view pulls the Gaussians."""
        k = turn % len(self._pictures)
        drawing = self._pictures[k].draw()
        if k not in self._losses or self._losses[k][0] is not drawing:
            self._losses[k] = drawing, RetainedMse(drawing.rgb, self._imagined.images[k], self._weight, drawing.v_rgb)
        self._losses[k][1]()
        drawing.v_depth.zero_()
        drawing.v_alpha.zero_()
        self._pictures[k].adjoint()
        self._pulls = [WEIGHT * gradient[: len(self._imagined.body)] for gradient in self._cloud.gradients]

    def add(self) -> None:
        """Add what `draw` found to the gradients that a frame left."""
        for gradient, pull in zip(self._cloud.gradients, self._pulls, strict=True):
            gradient[: len(pull)] += pull


def imagine(
    body: Gaussians, surface: VehiclePoints, shots: Sequence[Shot], sun: NDArray | None, threads: int
) -> Imagined | None:
    """How the vehicle looks from all around; None where the frames show none of its discs.

    Args:
        body: Discs in the colours of the points, see `initialize_body`.
        surface: The points.
        shots: Frames that teach.
        sun: [3] where it stands in the vehicle's frame, if a shadow says so.
        threads: Views at a time.
    """
    chosen = [shots[i] for i in np.unique(np.linspace(0, len(shots) - 1, min(LOOKS, len(shots))).astype(int))]
    appearance = look(body, chosen, surface.normals is not None, threads)
    if not appearance.is_seen.any():
        return None
    paints = np.clip(0.5 + SH_C0 * body.sh[:, 0], 0, 1)
    light = find_light(paints, appearance, sun)
    skin = complete(body.means, paints, appearance, light)
    dense, discs = _refine(skin, body, surface)
    length = float(np.ptp(body.means, axis=0).max())

    def paint(k: int) -> tuple[View, Tensor]:
        view, eye = _view_around(2 * np.pi * ((k * 0.618034) % 1), ELEVATIONS[k % len(ELEVATIONS)], length)
        toward = eye - dense.means
        faces = np.ones(len(toward), bool)
        if surface.normals is not None:
            faces = (toward * dense.normals).sum(1) > 0
        seen_so = colored(discs[faces], dense[faces].colors(light, toward[faces]))
        with torch.no_grad():
            image = render(Splats.from_gaussians(seen_so), view, _grey_layers(), threads=1).rgb
        return view, image.movedim(-1, 0).contiguous().movedim(0, -1)  # plane by plane, as pictures are stored

    with ThreadPoolExecutor(threads) as pool:
        views, images = zip(*pool.map(paint, range(VIEWS)), strict=True)
    return Imagined(colored(body, skin.colors(light, skin.normals)), views, images)


def complete(means: NDArray, paints: NDArray, appearance: Appearance, light: Light) -> Skin:
    """All discs as they are thought to be.

    They are as the light shows them, and what it does not explain is added: of a disc itself where frames show it, else
    that of the shown discs that lie, or whose mirror images lie, next to it, face as it does and are painted alike;
    where there are none, that of all.
    """
    seen, normals = appearance.is_seen, appearance.normals
    explained = light.shown(paints[seen], normals[seen], appearance.mirrored[seen])
    unexplained = np.zeros((len(means), 3))
    unexplained[seen] = appearance.colors[seen] - srgb_from_linear(explained)
    features = _features(means, normals, paints)
    images = _features(means * MIRROR, normals * MIRROR, paints)
    shown = KDTree(np.concatenate([features[seen], images[seen]]))
    count = min(NEIGHBOURS, shown.n)
    distances, near = (np.reshape(part, (-1, count)) for part in shown.query(features[~seen], count))
    near = near % np.count_nonzero(seen)
    weight = np.sqrt(appearance.pixels[seen])[near] / (distances**2 + NEAR**2)
    alike = (weight[..., None] * unexplained[seen][near]).sum(1) / weight.sum(1, keepdims=True)
    common = appearance.pixels[seen] @ unexplained[seen] / appearance.pixels[seen].sum()
    unexplained[~seen] = common + (alike - common) / (1 + (distances.min(1, keepdims=True) / APART) ** 2)
    return Skin(means, normals, paints, unexplained)


def _refine(skin: Skin, body: Gaussians, surface: VehiclePoints) -> tuple[Skin, Gaussians]:
    """The skin at as many as `DENSE` of the points, and their discs, which share the area of that next to them."""
    each = slice(None, None, len(surface.points) // DENSE + 1)
    means, paints = surface.points[each].astype(np.float64), surface.colors[each] / 255
    if surface.normals is None:
        nearest = KDTree(skin.means).query(means)[1]
        normals = skin.normals[nearest]
    else:
        normals = surface.normals[each].astype(np.float64)
        discs = KDTree(_features(skin.means, skin.normals, skin.paints))
        nearest = discs.query(_features(means, normals, paints))[1]
    scales = body.scales[nearest] / np.sqrt(np.bincount(nearest))[nearest, None]
    dense = body[nearest]
    opacities = np.full(len(means), OPACITY, np.float32)
    dense = replace(dense, means=means.astype(np.float32), scales=scales.astype(np.float32), opacities=opacities)
    return Skin(means, normals, paints, skin.unexplained[nearest]), dense


def _features(means: NDArray, normals: NDArray, paints: NDArray) -> NDArray[np.float64]:
    """[N, 9] what makes discs alike."""
    return np.hstack([means, TURN * normals, TINT * paints])


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
