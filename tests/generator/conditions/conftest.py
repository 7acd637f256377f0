"""A street without anything, and an insertion."""

import numpy as np
import pytest
from toy_vehicle import FRAMES, LOOK_ALONG_X, SIZE, box_points, drive

from dwgs.scene import Camera, Frame, Insertion, Scene, Trajectory
from dwgs.scene.pose import pose
from generator.conditions import mesh as mesh_module


@pytest.fixture
def scene() -> Scene:
    """One camera 1.5 m above the origin looks along +x and stands still for 0.2 s; all it sees is green."""

    def frame(i: int) -> Frame:
        K = np.array([[100, 0, 80], [0, 100, 60], [0, 0, 1]], float)
        camera = Camera(K, 160, 120, pose(LOOK_ALONG_X, [0, 0, 1.5]), 0.1 * i)
        return Frame(10 + i, "front", camera, lambda: np.full((120, 160, 3), (0, 200, 0), np.uint8))

    ego = Trajectory(np.arange(FRAMES) * 0.1, np.stack([np.eye(4)] * FRAMES))
    return Scene("green", {"front": tuple(frame(i) for i in range(FRAMES))}, ego)


@pytest.fixture
def insertion() -> Insertion:
    return Insertion(box_points(SIZE), SIZE, drive(8.0))


@pytest.fixture
def few_samples(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mesh_module, "SAMPLES", 1 << 13)
