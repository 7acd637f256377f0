"""A still picture of a scene."""

import numpy as np
import pytest
from PIL import Image

from dwgs.inspect import SIZE, inspect
from dwgs.scene import Camera, Frame, Gaussians, LidarSweep, Scene, Track, Trajectory
from dwgs.scene.pose import pose

STILL = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]]).T  # a camera that looks along x


def scene_of(has_sweeps: bool) -> Scene:
    rng = np.random.default_rng(0)
    camera = Camera(np.diag([50.0, 50, 1]), 64, 48, pose(STILL, [0, 0, 1.8]), 0.0)
    points = np.column_stack([rng.uniform(-40, 40, (20000, 2)), np.zeros(20000)]).astype(np.float32)
    sweep = LidarSweep(points, np.zeros(20000), np.zeros(3), 0.0, 0)
    at = pose(np.broadcast_to(np.eye(3), (2, 3, 3)), np.array([[8.0, 3, 0.8], [12, 3, 0.8]]))
    return Scene(
        name="drive",
        frames={"front": (Frame(0, "front", camera, lambda: np.zeros((48, 64, 3), np.uint8)),)},
        ego=Trajectory(np.array([0.0, 1.0]), pose(np.broadcast_to(np.eye(3), (2, 3, 3)), [[0.0, 0, 0], [9, 0, 0]])),
        sweeps=(sweep,) if has_sweeps else (),
        tracks=(Track("a", "Car", np.array([4.5, 1.8, 1.5]), Trajectory(np.array([0.0, 1.0]), at), True),),
    )


@pytest.mark.parametrize("has_sweeps", [True, False])
def test_the_picture_shows_boxes_ego_and_ground(tmp_path, has_sweeps):
    inspect(scene_of(has_sweeps), tmp_path / "scene.png")
    image = np.array(Image.open(tmp_path / "scene.png").convert("RGB")).astype(int)
    assert image.shape == (SIZE[1], SIZE[0], 3)

    def share(colour: str) -> float:
        target = [int(colour[i : i + 2], 16) for i in (1, 3, 5)]
        return float((abs(image - target).max(2) < 30).mean())

    assert share("#ff8c2b") > 1e-3
    assert share("#38e08c") > 4e-4
    assert (share("#10151c") < 0.98) == has_sweeps


def test_centres_of_gaussians_show_in_their_own_colour(tmp_path):
    rng = np.random.default_rng(0)
    count = 20000
    red = (np.array([0.9, 0.1, 0.1], np.float32) - 0.5) / 0.28209479
    cloud = Gaussians(
        means=np.column_stack([rng.uniform(-10, 30, (count, 2)), np.zeros(count)]).astype(np.float32),
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1)),
        scales=np.full((count, 3), 0.1, np.float32),
        opacities=np.ones(count, np.float32),
        sh=np.tile(red, (count, 1, 1)),
    )
    inspect(scene_of(True), tmp_path / "scene.png", cloud)
    image = np.array(Image.open(tmp_path / "scene.png").convert("RGB")).astype(int)
    assert ((abs(image - (230, 26, 26)) < 20).all(2)).mean() > 0.01
