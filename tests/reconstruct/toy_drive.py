"""A straight street that NumPy can paint: ground, a wall, sky, and a red car that never leaves."""

from dataclasses import replace

import numpy as np

from dwgs.scene import Camera, Frame, LidarSweep, Scene, Track, Trajectory
from dwgs.scene.pose import inverse, pose
from dwgs.scene.silhouette import box_silhouette

AHEAD = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], float)
"""world_from_camera rotation that looks along +x."""
K = np.array([[80, 0, 48], [0, 80, 28], [0, 0, 1]], float)
WIDTH, HEIGHT = 96, 64
EYE = 1.5
"""Height of the camera over the ground [m]."""
WALL = 30.0
"""The street ends at this x [m]; above the wall, 4 m high, is sky."""
CAR_SIZE = np.array([4.0, 1.8, 1.5])
CAR_COLOR = np.array([250, 10, 10])
SKY_COLOR = np.array([150, 190, 240])


def ground_color(points):
    """[..., 3] of the road at world points: grey with broad stripes across."""
    stripe = 90 + 30 * np.sin(points[..., :1] * 1.5) + 15 * np.sin(points[..., 1:2] * 2)
    return stripe * [1, 1, 1.05]


def wall_color(points):
    return 120 + 50 * np.sin(points[..., 1:2] * 1.2) * [1, 0.5, 0.2]


def paint(camera):
    """[H, W, 3] of the empty street."""
    x, y = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    rays = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(K).T @ camera.world_from_camera[:3, :3].T
    origin = camera.position
    to_ground = origin[2] / np.maximum(-rays[..., 2], 1e-9)
    to_wall = (WALL - origin[0]) / rays[..., 0]
    on_ground, on_wall = (origin + t[..., None] * rays for t in (to_ground, to_wall))
    image = np.where((on_wall[..., 2:] < 4), wall_color(on_wall), SKY_COLOR)
    return np.where((to_ground < to_wall)[..., None], ground_color(on_ground), image)


def make_drive(frames=9, traffic=True, seed=0):
    """A straight drive of 0.5 m a frame towards a wall, behind a red car that keeps 9 m ahead."""
    rng = np.random.default_rng(seed)
    times = np.arange(frames) / 10
    ego = [pose(np.eye(3), [0.5 * i, 0, 0]) for i in range(frames)]
    car = [pose(np.eye(3), [0.5 * i + 9, 0.5, CAR_SIZE[2] / 2]) for i in range(frames)]
    recorded, sweeps = [], []
    for i in range(frames):
        camera = Camera(K, WIDTH, HEIGHT, pose(AHEAD, [0.5 * i, 0, EYE]), times[i])
        image = paint(camera)
        ground = np.column_stack([rng.uniform(0.5 * i + 2, WALL, 2500), rng.uniform(-12, 12, 2500), np.zeros(2500)])
        wall = np.column_stack([np.full(1200, WALL), rng.uniform(-16, 16, 1200), rng.uniform(0, 4, 1200)])
        points = np.concatenate([ground, wall])
        if traffic:
            image[box_silhouette(camera, car[i], CAR_SIZE)] = CAR_COLOR
            points = points[~_hidden(np.array([0.5 * i, 0, 1.8]), points, car[i])]
        image = image.clip(0, 255).astype(np.uint8)
        recorded.append(Frame(i, "front", camera, lambda image=image: image))
        stamps = np.full(len(points), times[i])
        sweeps.append(LidarSweep(points.astype(np.float32), stamps, ego[i][:3, 3] + [0, 0, 1.8], times[i], i))
    track = Track("car", "Car", CAR_SIZE, Trajectory(times, np.array(car)), is_moving=True)
    return Scene("toy", {"front": tuple(recorded)}, Trajectory(times, np.array(ego)), tuple(sweeps), (track,) * traffic)


def _hidden(origin, points, world_from_car):
    """Points whose ray from ``origin`` meets the car's box (slabs)."""
    car_from_world = inverse(world_from_car)
    start = car_from_world[:3, :3] @ origin + car_from_world[:3, 3]
    along = (points - origin) @ car_from_world[:3, :3].T
    along = np.where(np.abs(along) < 1e-9, 1e-9, along)
    hits = np.sort((np.array([-0.5, 0.5])[:, None, None] * CAR_SIZE - start) / along, axis=0)
    enter, leave = hits[0].max(1), hits[1].min(1)
    return (enter < leave) & (enter < 1) & (leave > 0)


def repaint(scene, change):
    """The scene with every frame's pixels passed through ``change(frame, pixels)``."""

    def changed(frame):
        pixels = change(frame, frame.pixels.copy())
        return replace(frame, load_pixels=lambda: pixels)

    return replace(scene, frames={n: tuple(changed(f) for f in fs) for n, fs in scene.frames.items()})
