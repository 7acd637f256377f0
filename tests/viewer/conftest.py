"""A street to look at, and a renderer where the machine can draw."""

import numpy as np
import pytest
from random_world import HEIGHT, WIDTH, random_cloud

from dwgs.scene import Background, InputError, Trajectory, VehicleAsset
from dwgs.scene.pose import pose, yaw_rotation
from viewer.renderer import Renderer
from viewer.scene_graph import SceneGraph


@pytest.fixture(scope="session")
def renderer():
    try:
        made = Renderer(WIDTH, HEIGHT)
    except InputError as error:
        pytest.skip(str(error))
    with made:
        yield made


@pytest.fixture
def street() -> SceneGraph:
    """A background that also lies before and behind two cars, which drive and turn."""
    rng = np.random.default_rng(5)
    background = Background(
        random_cloud(rng, 1500, (2, -12, -1), (40, 12, 6), 0.3), rng.random((16, 32, 3)).astype(np.float32)
    )
    actors = []
    for ahead, count in ((9, 16), (14, 4)):
        body = random_cloud(rng, 300, (-2, -0.9, -0.7), (2, 0.9, 0.7), 0.1, count)
        shadow = random_cloud(rng, 60, (-2.4, -1.2, -0.76), (2.4, 1.2, -0.74), 0.1, 1)
        asset = VehicleAsset(body, shadow, np.array([4.0, 1.8, 1.4]))
        poses = pose(yaw_rotation([0.3, 0.9]), [[ahead, -2, 0.7], [ahead + 4, 1, 0.7]])
        actors.append((asset, Trajectory(np.array([0.0, 1.0]), poses)))
    return SceneGraph(background, actors)
