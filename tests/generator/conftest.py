"""A backbone of toy size, an adapter for it, and a drive with a block that passes."""

import numpy as np
import pytest

from dwgs.scene import Camera, Frame, Insertion, Scene, Trajectory, VehiclePoints
from generator.conditions import ConditionFrame, Conditions
from generator.conditions.raster import GREY

HEIGHT, WIDTH = 32, 48


@pytest.fixture(scope="session")
def backbone_folder(tmp_path_factory):
    """A Wan2.1-VACE folder of toy size."""
    from generator.wan.tiny import write_tiny_backbone

    folder = tmp_path_factory.mktemp("wan") / "backbone"
    write_tiny_backbone(folder)
    return folder


@pytest.fixture(scope="session")
def adapter_folder(tmp_path_factory):
    """A PointAdapter for that backbone, as it starts."""
    from generator.wan.adapter import new_adapter
    from generator.wan.tiny import tiny_transformer

    folder = tmp_path_factory.mktemp("wan") / "adapter"
    new_adapter(tiny_transformer()).save(folder)
    return folder


@pytest.fixture(scope="session")
def conditions():
    """Makes conditions for so many frames of a drive: noise, through which a speckled block moves."""

    def make(frames: int, width: int = WIDTH) -> Conditions:
        def frame(i: int) -> ConditionFrame:
            rng = np.random.default_rng(i)
            K = np.array([[width, 0, width / 2], [0, width, HEIGHT / 2], [0, 0, 1]])
            camera = Camera(K, width, HEIGHT, np.eye(4), 0.1 * i)
            pixels = rng.integers(0, 256, (HEIGHT, width, 3), np.uint8)
            mask = np.zeros((HEIGHT, width), bool)
            mask[8:24, 4 + i % 20 : 24 + i % 20] = True
            points = mask & (rng.random(mask.shape) < 0.4)
            image = np.where(points[..., None], np.uint8(200), np.uint8(GREY)).repeat(3, -1)
            recorded = Frame(i, "front", camera, lambda: pixels)
            return ConditionFrame(recorded, lambda: image, lambda: points, lambda: mask)

        drawn = tuple(frame(i) for i in range(frames))
        poses = Trajectory(0.1 * np.arange(frames + 1), np.stack([np.eye(4)] * (frames + 1)))
        scene = Scene("noise", {"front": tuple(c.frame for c in drawn)}, poses)
        vehicle = VehiclePoints(np.zeros((1, 3), np.float32), np.zeros((1, 3), np.uint8))
        return Conditions(scene, Insertion(vehicle, np.ones(3), poses), {"front": drawn})

    return make
