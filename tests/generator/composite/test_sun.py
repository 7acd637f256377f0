import numpy as np

from dwgs.scene import Camera, Frame, LidarSweep, Scene, Trajectory
from dwgs.scene.pose import pose
from generator.composite.sun import find_sun

ELEVATION, AZIMUTH = np.radians(40), np.radians(120)
TOWARDS = np.array([np.cos(ELEVATION) * np.cos(AZIMUTH), np.cos(ELEVATION) * np.sin(AZIMUTH), np.sin(ELEVATION)])
DOWN = np.array([[0.0, -1, 0], [-1, 0, 0], [0, 0, -1]])


def square(has_sun):
    """Posts on a pale square, seen from above, with the shadows of a known sun, or without any."""
    rng = np.random.default_rng(0)
    camera = Camera(np.array([[200.0, 0, 200], [0, 200, 200], [0, 0, 1]]), 400, 400, pose(DOWN, [0, 0, 18]), 0.0)
    posts = rng.uniform(-14, 14, (14, 2))
    z = np.linspace(0.4, 2.5, 60)
    around = rng.uniform(-0.5, 0.5, (14, 60, 2)) + posts[:, None]
    obstacles = np.concatenate([np.column_stack([a, z]) for a in around])
    floor = np.column_stack([rng.uniform(-16, 16, (8000, 2)), np.zeros(8000)])
    image = np.full((400, 400, 3), 180, np.uint8)
    if has_sun:
        fallen = obstacles.copy()
        fallen[:, :2] -= obstacles[:, 2:] * TOWARDS[:2] / TOWARDS[2]
        fallen[:, 2] = 0
        for column, row in camera.project(fallen)[0].astype(int):
            image[max(row - 3, 0) : row + 4, max(column - 3, 0) : column + 4] = 70
    points = np.concatenate([floor, obstacles]).astype(np.float32)
    sweep = LidarSweep(points, np.zeros(len(points)), np.zeros(3), 0.0, 0)
    frame = Frame(0, "top", camera, lambda: image)
    ego = Trajectory(np.array([0.0]), np.eye(4)[None])
    return Scene("square", {"top": (frame,)}, ego, (sweep,)), [frame]


def test_the_sun_is_found_where_its_shadows_point():
    sun = find_sun(*square(has_sun=True))
    assert sun is not None
    assert sun.direction @ TOWARDS > np.cos(np.radians(12))
    assert sun.sunlit.mean() > 2.5 * sun.shaded.mean()


def test_ground_without_shadows_has_no_sun():
    assert find_sun(*square(has_sun=False)) is None
