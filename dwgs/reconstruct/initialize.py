"""The cloud before its first step: LiDAR surfaces, the road in their gaps, a far shell before the sky."""

from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn.functional import avg_pool2d, max_pool2d

from dwgs.reconstruct.config import ReconstructConfig
from dwgs.reconstruct.depth_samples import pixels_of
from dwgs.reconstruct.discs import discs, sh_of_color
from dwgs.reconstruct.sky import SHELL_CONTRAST, far_shell, paint_sky
from dwgs.reconstruct.thinning import spacing_in_view, thin
from dwgs.reconstruct.unseen import continue_colors, meet_ground, road_seen
from dwgs.reconstruct.views import TrainingView, evenly
from dwgs.scene import Gaussians, InputError, Scene
from dwgs.scene.ground import Ground
from dwgs.scene.sky import pixel_rays, sky_colors
from dwgs.splat import Splats, View, render

GAP_VIEWS, COLOR_VIEWS = 12, 48
"""At most so many views are searched for gaps, and asked for colours: neighbours see nearly the same."""
POINT_SWEEPS = 64
"""At most so many sweeps give points: neighbours hit nearly the same."""
GAP_WINDOW = 7
"""A gap is where the LiDAR covers less than `GAP_ALPHA` of a window of so many pixels."""
GAP_ALPHA = 0.6
SKY_WINDOW, SKY_CONTRAST = 9, 0.02
"""Sky varies less than this standard deviation within so many pixels; walls and trees vary more."""
OPACITY, ROAD_OPACITY = 0.8, 0.95
"""At the start. What no loss will ever touch is nearly opaque from the beginning."""
HEARSAY = 1e-3
"""Weight of a colour painted over traffic beside a colour that was seen."""
ROAD_TOLERANCE = 0.25
"""Points this near to the ground [m] are road."""


@dataclass(frozen=True)
class Gaps:
    """Pixels of some views that the LiDAR leaves empty."""

    road: NDArray[np.float64]
    """[R, 3] where those that look down meet the ground [m]."""
    road_sizes: NDArray[np.float64]
    """[R] how far apart points of road should lie there [m]."""
    far: NDArray[np.float64]
    """[F, 3] world directions of all others, those that saw something first."""
    far_colors: NDArray[np.float64]
    """[F, 3]."""
    far_seen: NDArray[np.bool_]
    """[F] whether the colour was seen rather than painted over traffic."""
    far_smooth: NDArray[np.bool_]
    """[F] whether there is so little to see that it may be sky."""


def initialize(
    scene: Scene,
    ground: Ground,
    static: dict[int, NDArray[np.float32]],
    views: list[TrainingView],
    config: ReconstructConfig,
) -> tuple[Gaussians, NDArray[np.float32]]:
    """Gaussians in the world and the sky image behind them.

    Args:
        scene: The drive.
        ground: How high its road lies.
        static: Frame index to the points [P, 3] of its sweep that lie on nothing that moves.
        views: The frames that teach.
        config: How many Gaussians, and the seed.

    Raises:
        InputError: No LiDAR point lies in front of a camera.
    """
    points, sizes = lidar_points(scene, static, views, config)
    lidar = discs(points, sizes, OPACITY)
    gaps = find_gaps(lidar, views, ground, config.threads)
    road, road_sizes = thin(gaps.road, gaps.road_sizes)
    points, sizes = np.concatenate([points, road]), np.concatenate([sizes, road_sizes])
    near = discs(points, sizes, OPACITY)
    colors, evidence = observe_colors(near, views, config.threads)

    is_seen = evidence > 0.5
    is_road = np.abs(points[:, 2] - ground.height(points[:, :2])) < ROAD_TOLERANCE
    colors = continue_colors(points, colors, (evidence > 0) & is_road, (evidence == 0) & is_road)
    opacities = np.where(is_seen, OPACITY, ROAD_OPACITY).astype(np.float32)
    near = replace(near, opacities=opacities, sh=sh_of_color(colors))[(evidence > 0) | is_road]

    asphalt = np.median(colors[is_seen & is_road], 0) if (is_seen & is_road).any() else np.full(3, 0.5)
    is_sky = gaps.far_seen & gaps.far_smooth & (gaps.far[:, 2] > 0)
    sky = paint_sky(gaps.far[is_sky], gaps.far_colors[is_sky], asphalt)
    return Gaussians.concatenate([near, _shell(gaps, sky, views)]), sky


def lidar_points(
    scene: Scene, static: dict[int, NDArray[np.float32]], views: list[TrainingView], config: ReconstructConfig
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points [N, 3] on the street as dense as the images resolve, and how far apart they lie [N] [m]."""
    points = np.concatenate(evenly(list(static.values()), POINT_SWEEPS))
    sizes = spacing_in_view(points, [view.camera for view in evenly(views, GAP_VIEWS)])
    in_view = np.isfinite(sizes)
    if not in_view.any():
        raise InputError(
            f"no LiDAR point of '{scene.name}' lies in front of its cameras; check that points and camera "
            "poses share one world frame"
        )
    points, sizes = thin(points[in_view], sizes[in_view])
    kept = np.sort(np.random.default_rng(config.seed).permutation(len(points))[: config.gaussians])
    # Fewer points have to cover the same surface.
    return points[kept], sizes[kept] * np.sqrt(len(points) / len(kept))


def find_gaps(lidar: Gaussians, views: list[TrainingView], ground: Ground, threads: int) -> Gaps:
    """Every second pixel of some views that no LiDAR disc covers, sorted into road and distance."""
    splats = Splats.from_gaussians(lidar)
    road, road_sizes, far, far_colors, far_seen, far_smooth = [], [], [], [], [], []
    for view in evenly(views, GAP_VIEWS):
        camera = view.camera
        with torch.no_grad():
            alpha = render(splats, View.from_camera(camera), threads=threads).alpha
            alpha = avg_pool2d(alpha[None, None], GAP_WINDOW, 1, GAP_WINDOW // 2)[0, 0].numpy()
        empty = alpha < GAP_ALPHA
        points, spacing = road_seen(ground, camera, empty)
        road.append(points)
        road_sizes.append(spacing)
        empty[1::2] = empty[:, 1::2] = False
        rays = pixel_rays(camera)[empty]
        arrives = meet_ground(ground, camera.position, rays)[1]
        far.append(rays[~arrives])
        far_colors.append(view.pixels[empty][~arrives] / 255)
        far_seen.append(~view.hidden[empty][~arrives])
        far_smooth.append(_is_smooth(view.pixels)[empty][~arrives])
    seen = np.concatenate(far_seen)
    order = np.argsort(~seen, kind="stable")
    return Gaps(
        np.concatenate(road),
        np.concatenate(road_sizes),
        np.concatenate(far)[order],
        np.concatenate(far_colors)[order],
        seen[order],
        np.concatenate(far_smooth)[order],
    )


def _is_smooth(pixels: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Pixels [H, W] of an image [H, W, 3] whose surroundings vary less than `SKY_CONTRAST`."""
    grey = torch.from_numpy(pixels.mean(-1, dtype=np.float32))[None, None] / 255
    window = {"kernel_size": SKY_WINDOW, "stride": 1, "padding": SKY_WINDOW // 2, "count_include_pad": False}
    variance = avg_pool2d(grey**2, **window) - avg_pool2d(grey, **window) ** 2
    return (variance < SKY_CONTRAST**2)[0, 0].numpy()


def observe_colors(
    gaussians: Gaussians, views: list[TrainingView], threads: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean colour [N, 3] of each Gaussian over the views that see it, and the weight [N] behind it.

    A view counts 1, or `HEARSAY` where traffic was painted over; weight 0 means never in view.
    """
    splats = Splats.from_gaussians(gaussians)
    sums, weights = np.zeros((len(gaussians), 3)), np.zeros(len(gaussians))
    for view in evenly(views, COLOR_VIEWS):
        with torch.no_grad():
            surface = render(splats, View.from_camera(view.camera), threads=threads).expected_depth
            # A pixel of road far away spans metres of depth: the farthest of its neighbours is still the surface.
            surface = max_pool2d(surface[None, None], 3, 1, 1)[0, 0].numpy()
        index, rows, columns, depths = pixels_of(gaussians.means, view.camera)
        visible = depths < 1.03 * surface[rows, columns] + 0.1
        index, rows, columns = index[visible], rows[visible], columns[visible]
        weight = np.where(view.hidden[rows, columns], HEARSAY, 1.0)
        sums[index] += weight[:, None] * view.pixels[rows, columns] / 255
        weights[index] += weight
    return sums / np.maximum(weights, 1e-9)[:, None], weights


def _shell(gaps: Gaps, sky: NDArray[np.float32], views: list[TrainingView]) -> Gaussians:
    """Far Gaussians wherever the smooth sky alone is not what was seen."""
    differs = np.abs(gaps.far_colors - sky_colors(sky, gaps.far)).max(1, initial=0) > SHELL_CONTRAST
    centre = np.mean([view.camera.position for view in views], 0)
    return far_shell(centre, gaps.far[differs], gaps.far_colors[differs], views[0].camera.K[0, 0])
