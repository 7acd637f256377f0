"""Small random clouds and a camera that sees them."""

import numpy as np

from dwgs.scene import Camera, Gaussians
from dwgs.scene.pose import pose

WIDTH, HEIGHT = 120, 80
AHEAD = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], float)
"""``world_from_camera`` rotation that looks along +x."""


def random_cloud(rng, n, low, high, size=0.2, count=16) -> Gaussians:
    quats = rng.normal(size=(n, 4))
    return Gaussians(
        rng.uniform(low, high, (n, 3)).astype(np.float32),
        (quats / np.linalg.norm(quats, axis=1, keepdims=True)).astype(np.float32),
        np.exp(rng.normal(np.log(size), 0.5, (n, 3))).astype(np.float32),
        rng.uniform(0.02, 1, n).astype(np.float32),
        rng.normal(0, 0.25, (n, count, 3)).astype(np.float32),
    )


def camera(rotation=AHEAD, position=(0, 0, 1.5), time=0.5) -> Camera:
    K = np.array([[90, 0, 58], [0, 95, 41], [0, 0, 1]], float)
    return Camera(K, WIDTH, HEIGHT, pose(rotation, position), time)


def psnr(a, b) -> float:
    return float(-10 * np.log10(np.mean((np.asarray(a, np.float64) - b) ** 2) + 1e-20))
