import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from dwgs.scene import Camera
from dwgs.scene.pose import pose, yaw_rotation


@given(st.integers(0, 1000))
def test_no_point_of_the_image_is_thought_unseen(seed):
    rng = np.random.default_rng(seed)
    K = np.array([[300.0, 0, 50], [0, 310, 40], [0, 0, 1]])
    camera = Camera(K, 110, 90, pose(yaw_rotation(rng.uniform(-3, 3)), rng.normal(0, 2000, 3)), 0.0)
    points = np.float32(camera.position + rng.normal(0, 30, (500, 3)))
    pixels, depth = camera.project(points)
    inside = (depth > 0) & (pixels >= 0).all(1) & (pixels < (110, 90)).all(1)
    may_see = camera.may_see(points)
    assert may_see[inside].all()
    assert may_see.sum() <= inside.sum() + 50
