"""A toy street: a ground of Gaussians, a coloured box that drives past on it, a camera at the kerb."""

from dataclasses import dataclass

import numpy as np

from dwgs.scene import Background, Camera, Frame, Gaussians, Insertion, Scene, Trajectory, VehiclePoints
from dwgs.scene.pose import pose, transform_points, yaw_rotation
from dwgs.scene.silhouette import box_silhouette
from dwgs.scene.sky import sky_image
from dwgs.splat import Splats, View, render
from dwgs.splat.constants import SH_C0

WIDTH, HEIGHT, FRAMES = 96, 64, 12
SIZE = np.array([4.0, 1.8, 1.5])
CAMERA_AXES = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], float)
"""Columns: right, down, forward of a camera that looks along world x."""


def flat_colors(colors):
    return ((np.asarray(colors) - 0.5) / SH_C0)[:, None].astype(np.float32)


def cloud(means, colors, scales, opacity=0.9):
    n = len(means)
    return Gaussians(
        np.float32(means),
        np.tile(np.float32([1, 0, 0, 0]), (n, 1)),
        np.tile(np.float32(scales), (n, 1)),
        np.full(n, opacity, np.float32),
        flat_colors(colors),
    )


def box_surface(rng, count):
    """Points on the sides and the roof of the vehicle's box, with outward normals."""
    axis = rng.choice(3, count, p=[0.2, 0.4, 0.4])
    sign = np.where(axis == 2, 1, rng.choice([-1, 1], count))
    points = rng.uniform(-0.5, 0.5, (count, 3)) * SIZE
    points[np.arange(count), axis] = sign * SIZE[axis] / 2
    normals = np.zeros((count, 3))
    normals[np.arange(count), axis] = sign
    return points, normals


def paint(points):
    """Smooth colours that tell every side from every other."""
    waves = np.sin(points * [2.0, 3.0, 4.0] + [0, 1, 2])
    return np.clip(0.5 + 0.35 * waves, 0, 1)


@dataclass(frozen=True)
class Toy:
    background: Background
    insertion: Insertion
    truth: Gaussians
    """The vehicle itself, in its frame."""
    cameras: tuple[Camera, ...]

    def picture(self, camera, with_vehicle=True):
        """[H, W, 3] float: one cloud, rendered in one go, over the sky."""
        clouds = [self.background.gaussians]
        if with_vehicle:
            clouds.append(placed(self.truth, self.insertion.trajectory.at(camera.time)))
        rendering = render(Splats.from_gaussians(Gaussians.concatenate(clouds)), View.from_camera(camera))
        sky = sky_image(self.background.sky, camera)
        return rendering.rgb.numpy() + (1 - rendering.alpha.numpy())[..., None] * sky

    def frame(self, index, pixels=None, is_generated=True):
        camera = self.cameras[index]
        if pixels is None:
            pixels = np.round(self.picture(camera).clip(0, 1) * 255).astype(np.uint8)
        mask = box_silhouette(camera, self.insertion.trajectory.at(camera.time), SIZE, 3)
        return Frame(index, "front", camera, lambda: pixels, (lambda: mask) if is_generated else None)

    def scene(self, sweeps=(), is_generated=True, tracks=()):
        frames = tuple(self.frame(i, is_generated=is_generated) for i in range(len(self.cameras)))
        return Scene("toy", {"front": frames}, self.insertion.trajectory, tuple(sweeps), tuple(tracks))


def placed(gaussians, world_from_vehicle):
    """View-independent Gaussians carried into the world; axis-aligned spheres stay spheres."""
    means = transform_points(world_from_vehicle, gaussians.means).astype(np.float32)
    return Gaussians(means, gaussians.quats, gaussians.scales, gaussians.opacities, gaussians.sh)


def make_toy():
    rng = np.random.default_rng(3)
    ground = np.column_stack([rng.uniform(2, 30, 3000), rng.uniform(-12, 12, 3000), rng.normal(0, 0.01, 3000)])
    greys = rng.uniform(0.3, 0.6, (3000, 1)) * [1, 1, 0.9]
    sky = np.tile(np.float32([0.5, 0.7, 0.9]), (8, 16, 1))
    background = Background(cloud(ground, greys, [0.3, 0.3, 0.02]), sky)

    points, normals = box_surface(rng, 6000)
    truth = cloud(points, paint(points), [0.05, 0.05, 0.05])
    vehicle = VehiclePoints(
        np.float32(points), np.full((6000, 3), 128, np.uint8), np.float32(normals), is_complete=True
    )
    times = np.arange(FRAMES) / 10
    positions = np.column_stack([9 + 0.1 * np.arange(FRAMES), 4 - 0.7 * np.arange(FRAMES), np.full(FRAMES, 0.75)])
    trajectory = Trajectory(times, pose(yaw_rotation(-1.2 + 0.05 * np.arange(FRAMES)), positions))
    K = np.array([[80.0, 0, WIDTH / 2], [0, 80, HEIGHT / 2], [0, 0, 1]])
    cameras = tuple(Camera(K, WIDTH, HEIGHT, pose(CAMERA_AXES, [0, 0, 1.5]), t) for t in times)
    return Toy(background, Insertion(vehicle, SIZE, trajectory), truth, cameras)
