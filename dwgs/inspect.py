"""One picture of a scene: what the LiDAR hit, who was there, which way the cameras went."""

from pathlib import Path

import numpy as np
import pyvista as pv
from numpy.typing import NDArray

from dwgs.files import new_file
from dwgs.scene.camera import Camera
from dwgs.scene.gaussians import Gaussians
from dwgs.scene.insertion import box_corners
from dwgs.scene.lidar import SURFACES, LidarSweep
from dwgs.scene.pose import inverse, transform_points
from dwgs.scene.scene import Scene
from dwgs.scene.track import Track

SIZE = (1600, 900)
"""Of the picture [px]."""
REACH = 70.0
"""How far from the ego [m] things are drawn."""

_BACKGROUND = "#10151c"
_MOVING, _STANDING, _EGO, _CAMERA = "#ff8c2b", "#5fa8ff", "#38e08c", "#f4f4f4"
_MOST_POINTS = 1_500_000
_MOST_SWEEPS = 20
_SH_DC = 0.28209479177387814


def inspect(scene: Scene, path: Path, gaussians: Gaussians | None = None) -> None:
    """Draw the scene at its middle frame from above and behind the ego, to the PNG at ``path``.

    LiDAR points of the whole drive by height, traffic only of that instant; boxes of moving tracks with the
    way they take, standing ones thinner; the ego path; the cameras. With ``gaussians``, their centres in
    their own colours take the place of the LiDAR.
    """
    frames = scene.frames[scene.main_camera]
    middle = frames[len(frames) // 2]
    time = middle.camera.time
    world_from_ego = scene.ego.at(time)
    here = [t for t in scene.tracks if t.trajectory.covers(time) and _is_near(t, time, world_from_ego)]
    with (
        pv.vtk_verbosity("off"),
        new_file(path) as draft,
    ):  # VTK complains of a missing screen, then does without
        plotter = pv.Plotter(off_screen=True, window_size=list(SIZE), lighting="none")
        plotter.renderer.set_background(_BACKGROUND)
        if gaussians is not None:
            _draw_centres(plotter, gaussians, world_from_ego)
        elif scene.sweeps:
            _draw_lidar(plotter, scene, middle.index, world_from_ego)
        for track in here:
            _draw_box(plotter, track, time)
        _draw_way(plotter, scene.ego.world_from_vehicle[:, :3, 3], _EGO, 6)
        for views in scene.frames.values():
            _draw_way(plotter, np.stack([frame.camera.position for frame in views]), _CAMERA, 2)
            for camera in (frame.camera for frame in views if frame.index == middle.index):
                _draw_frustum(plotter, camera)
        _caption(plotter, scene, middle.index, here, None if gaussians is None else len(gaussians))
        _look(plotter, world_from_ego)
        plotter.screenshot(draft)
        plotter.close()


def _draw_lidar(plotter: pv.Plotter, scene: Scene, index: int, world_from_ego: NDArray) -> None:
    """What stays, from sweeps of the whole drive, by height; what moves, from the instant's, in orange."""
    centre = world_from_ego[:2, 3]
    moving = [track for track in scene.tracks if track.is_moving]
    spread = np.unique(np.linspace(0, len(scene.sweeps) - 1, _MOST_SWEEPS).round().astype(int))
    still = []
    for sweep in (scene.sweeps[i] for i in spread):
        kept = ~_in_boxes(sweep, moving, slack=0.6)
        if sweep.labels is not None:
            kept &= ~np.isin(sweep.labels, [SURFACES.index("person"), SURFACES.index("noise")])
        still.append(_around(sweep.points[kept], centre))
    points = _thin(np.concatenate(still))
    if len(points):
        height = transform_points(inverse(world_from_ego), points)[:, 2]
        floor = float(np.quantile(height, 0.1))
        plotter.add_mesh(
            pv.PolyData(points),
            scalars=height,
            cmap="viridis",
            clim=[floor - 3, floor + 9],  # from below the road, which is not to be the darkest
            point_size=1.5,
            show_scalar_bar=False,
        )
    instant = min(scene.sweeps, key=lambda sweep: abs(sweep.frame_index - index))
    driven = _around(instant.points[_in_boxes(instant, moving, slack=0.0)], centre)
    if len(driven):
        plotter.add_mesh(pv.PolyData(driven), color=_MOVING, point_size=3)


def _in_boxes(sweep: LidarSweep, tracks: list[Track], slack: float) -> NDArray[np.bool_]:
    """Whether each point [P] lies in a box, grown by ``slack`` [m], of any of the tracks."""
    inside = np.zeros(len(sweep.points), bool)
    for track in tracks:
        if not track.trajectory.covers(sweep.time):
            continue
        world_from_box = track.trajectory.at(float(np.median(sweep.times)))
        reach = np.linalg.norm(track.size) / 2 + slack
        near = np.flatnonzero(abs(sweep.points[:, 0] - np.float32(world_from_box[0, 3])) < reach)
        local = transform_points(inverse(world_from_box), sweep.points[near])
        inside[near] |= (abs(local) < track.size / 2 + slack).all(1)
    return inside


def _around(points: NDArray, centre: NDArray) -> NDArray:
    return points[np.linalg.norm(points[:, :2] - centre, axis=1) < REACH]


def _draw_centres(plotter: pv.Plotter, gaussians: Gaussians, world_from_ego: NDArray) -> None:
    near = np.linalg.norm(gaussians.means - world_from_ego[:3, 3].astype(np.float32), axis=1) < REACH
    shown = near & (gaussians.opacities > 0.2)
    colours = np.clip(0.5 + _SH_DC * gaussians.sh[shown, 0], 0, 1)
    if shown.any():
        cloud = pv.PolyData(_thin(gaussians.means[shown]))
        plotter.add_mesh(cloud, scalars=_thin(colours), rgb=True, point_size=2.2, show_scalar_bar=False)


def _thin(array: NDArray) -> NDArray:
    return array[:: max(1, -(-len(array) // _MOST_POINTS))]


def _is_near(track: Track, time: float, world_from_ego: NDArray) -> bool:
    return float(np.linalg.norm(track.trajectory.at(time)[:2, 3] - world_from_ego[:2, 3])) < REACH


def _draw_box(plotter: pv.Plotter, track: Track, time: float) -> None:
    world_from_box = track.trajectory.at(time)
    corners = transform_points(world_from_box, box_corners(track.size))
    edges = [(a, b) for a in range(8) for b in range(a + 1, 8) if (a ^ b) in (1, 2, 4)]
    colour, width = (_MOVING, 4) if track.is_moving else (_STANDING, 2)
    plotter.add_lines(corners[np.array(edges).ravel()], color=colour, width=width)
    nose = [[track.size[0] / 2, 0, 0], [track.size[0] / 2 + 1, 0, 0]]
    plotter.add_lines(transform_points(world_from_box, nose), color=colour, width=width)
    if track.is_moving:
        _draw_way(plotter, track.trajectory.world_from_vehicle[:, :3, 3], _MOVING, 2)


def _draw_way(plotter: pv.Plotter, positions: NDArray, colour: str, width: float) -> None:
    if len(positions) > 1:
        plotter.add_lines(positions, color=colour, width=width, connected=True)


def _draw_frustum(plotter: pv.Plotter, camera: Camera, depth: float = 2.5) -> None:
    corners = np.array([[0, 0], [camera.width, 0], [camera.width, camera.height], [0, camera.height]], float)
    rays = np.column_stack([corners, np.ones(4)]) @ np.linalg.inv(camera.K).T
    rim = transform_points(camera.world_from_camera, depth * rays)
    lines = [point for i in range(4) for point in (camera.position, rim[i], rim[i], rim[(i + 1) % 4])]
    plotter.add_lines(np.array(lines), color=_CAMERA, width=2)


def _caption(plotter: pv.Plotter, scene: Scene, frame: int, here: list[Track], splats: int | None) -> None:
    moving = sum(track.is_moving for track in here)
    source = f"{len(scene.sweeps)} LiDAR sweeps" if splats is None else f"{splats:,} Gaussians"
    images = f"{len(scene.all_frames())} images of {len(scene.frames)} cameras"
    plotter.add_text(
        f"{scene.name}, frame {frame}: {images}, {source}",
        position=(24, SIZE[1] - 46),
        font_size=11,
        color="white",
    )
    legend = [
        (f"{moving} moving", _MOVING),
        (f"{len(here) - moving} standing", _STANDING),
        ("ego", _EGO),
        ("cameras", _CAMERA),
    ]
    for i, (text, colour) in enumerate(legend):
        plotter.add_text(text, position=(24 + 170 * i, SIZE[1] - 82), font_size=10, color=colour)


def _look(plotter: pv.Plotter, world_from_ego: NDArray) -> None:
    """From above and behind the ego, along its way."""
    eye, target = transform_points(world_from_ego, [[-27, 2, 21], [16, 1, 0]])
    plotter.camera.position = tuple(eye)
    plotter.camera.focal_point = tuple(target)
    plotter.camera.up = (0, 0, 1)
    plotter.camera.view_angle = 40
    plotter.camera.clipping_range = (0.5, 400)
