"""A box on wheels of five spokes that overtakes a camera, painted pixel by pixel: nothing is known of Gaussians."""

import numpy as np
import torch
from toy_street import cloud

from dwgs.distill.layers import FrozenView
from dwgs.distill.region import Region, Window
from dwgs.distill.shots import Shot, Sight
from dwgs.scene import Background, Camera, Frame, Insertion, Scene, Trajectory, VehiclePoints
from dwgs.scene.pose import inverse, pose
from dwgs.splat import Layers, Projected, View

SIZE = np.array([4.4, 1.8, 1.5])
RADIUS, SPOKES = 0.34, 5
HUBS = np.array([[1.33, -0.9, -0.40], [-1.31, -0.9, -0.40]])
WIDTH, HEIGHT, FRAMES = 420, 180, 14
SKY = np.array([0.5, 0.7, 0.9], np.float32)
LOOKING_AHEAD = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], float)


def drive(steps=None) -> Trajectory:
    """Past the camera on its left, by ``steps`` [frames - 1] [m] from frame to frame."""
    steps = 0.45 + 0.012 * np.arange(FRAMES - 1) if steps is None else steps
    places = np.column_stack([6.0 + np.append(0, np.cumsum(steps)), np.full(FRAMES, 4.0), np.full(FRAMES, 0.75)])
    return Trajectory(np.arange(FRAMES) / 10, pose(np.tile(np.eye(3), (FRAMES, 1, 1)), places))


def camera_at(time: float) -> Camera:
    K = np.array([[500.0, 0, 380], [0, 500, 30], [0, 0, 1]])
    return Camera(K, WIDTH, HEIGHT, pose(LOOKING_AHEAD, [0, 0, 1.2]), float(time))


def paint(camera: Camera, trajectory: Trajectory, radius: float) -> np.ndarray:
    """[H, W, 3] uint8; wheels turn as if they had such a radius: infinity makes them slide."""
    world_from_vehicle = trajectory.at(camera.time)
    way = trajectory.driven(camera.time)
    x, y = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    rays = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(camera.K).T
    vehicle_from_camera = inverse(world_from_vehicle) @ camera.world_from_camera
    eye, rays = vehicle_from_camera[:3, 3], rays @ vehicle_from_camera[:3, :3].T
    with np.errstate(divide="ignore"):
        ends = np.stack([(-SIZE / 2 - eye) / rays, (SIZE / 2 - eye) / rays])
    enters, leaves = ends.min(0), ends.max(0).min(-1)
    face, way_in = enters.argmax(-1), enters.max(-1)
    image = np.tile(SKY, (HEIGHT, WIDTH, 1))
    place = eye + way_in[..., None] * rays
    grey = np.choose(face, [0.35, 0.45 + 0.1 * np.sin(2 * place[..., 0]), 0.6])
    for hub in HUBS:
        across, up = place[..., 0] - hub[0], place[..., 2] - hub[2]
        reach, angle = np.hypot(across, up), np.arctan2(-up, across) - way / radius
        rim = np.where(np.cos(SPOKES * angle) > 0, 0.85, 0.25)
        wheel = np.where(reach < 0.05, 0.5, np.where(reach < 0.25, rim, 0.08))
        grey = np.where((face == 1) & (reach < RADIUS), wheel, grey)
    is_hit = (way_in < leaves) & (way_in > 0)
    image[is_hit] = grey[is_hit, None]
    return np.round(255 * image).astype(np.uint8)


def shots_of(trajectory: Trajectory, radius: float = RADIUS) -> list[tuple[Shot, View]]:
    """Every frame, as the loop of a distillation has it, and how it sees the vehicle."""
    shots = []
    for i, time in enumerate(trajectory.times):
        camera, stands = camera_at(time), trajectory.at(time)
        pixels = paint(camera, trajectory, radius)
        one = torch.ones(HEIGHT, WIDTH)
        layers = Layers.of(None, (torch.ones(HEIGHT, WIDTH, 3), one, one))
        frozen = FrozenView(layers, Projected(torch.zeros(0, 16)), torch.ones(3))
        everywhere = np.ones((HEIGHT, WIDTH), bool)
        region = Region(Window(0, 0, WIDTH, HEIGHT), everywhere, ~everywhere, ~everywhere)
        sight = Sight(Frame(i, "front", camera, lambda p=pixels: p), camera, camera, stands, region, held_out=False)
        view = View.from_camera(camera, stands)
        target = torch.from_numpy(pixels.astype(np.float32) / 255)
        shots.append((Shot(sight, view, frozen, pixels, target, one, None), view))
    return shots


def scene_of(trajectory: Trajectory, radius: float = RADIUS) -> tuple[Scene, Background, Insertion]:
    """The same as a recorded drive before an empty sky, and what a scan knows of the car."""
    frames = tuple(
        Frame(i, "front", camera_at(t), lambda t=t: paint(camera_at(t), trajectory, radius))
        for i, t in enumerate(trajectory.times)
    )
    random = np.random.default_rng(0)
    points = random.uniform(-0.5, 0.5, (20_000, 3)) * SIZE
    axis = random.choice([0, 1, 2], len(points), p=[0.2, 0.5, 0.3])
    points[np.arange(len(points)), axis] = SIZE[axis] / 2 * np.array([-1, -1, 1])[axis]
    vehicle = VehiclePoints(points.astype(np.float32), np.full(points.shape, 110, np.uint8))
    speck = cloud([[90, 0, 40]], [[0.5, 0.7, 0.9]], [0.1, 0.1, 0.1])
    background = Background(speck, np.tile(SKY, (4, 8, 1)))
    return Scene("toy", {"front": frames}, trajectory), background, Insertion(vehicle, SIZE, trajectory)
