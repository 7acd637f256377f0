"""A spinning LiDAR on the roof of the recording car."""

import numpy as np
import warp as wp
from numpy.typing import NDArray

from dwgs.scene.lidar import LidarSweep
from dwgs.scene.pose import pose
from dwgs.scene.trajectory import Trajectory
from dwgs.street import kernels
from dwgs.street.drive import PERIOD
from dwgs.street.world import Stage, transforms

ELEVATIONS = np.radians(
    np.concatenate([np.linspace(-26, -8, 18, False), np.linspace(-8, 3, 34, False), np.linspace(3, 18, 12)])
)
"""64 beams [rad], densest about the horizon."""
AZIMUTHS = 900
"""Columns per turn: every 0.4 degrees."""
REACH = 110.0
"""Furthest return [m]."""
NEAREST = 1.5
"""Nearest return [m]."""
RANGE_NOISE = 0.012
"""Standard deviation of the range [m]."""
EGO_FROM_SENSOR = pose(np.eye(3), (0.9, 0.0, 1.95))
"""Above the camera."""


def take_sweep(stage: Stage, ego: Trajectory, index: int, seed: int) -> LidarSweep:
    """One turn, from behind over the left, the front and the right; the front passes at the camera's time."""
    start = index * PERIOD
    turn = (np.arange(AZIMUTHS) + 0.5) / AZIMUTHS
    times = start + turn * PERIOD
    azimuths = np.pi - 2 * np.pi * turn
    world_from_sensor = ego.at(times) @ EGO_FROM_SENSOR
    directions = _directions(azimuths)
    ranges = np.zeros((AZIMUTHS, len(ELEVATIONS)), np.float32)
    labels = np.zeros((AZIMUTHS, len(ELEVATIONS)), np.uint8)
    inputs = [
        stage.at(times),
        transforms(world_from_sensor),
        wp.array(directions, dtype=wp.vec3, device="cpu"),
    ]
    outputs = [wp.array(a, device="cpu", copy=False) for a in (ranges, labels)]
    wp.launch(kernels.sweep, ranges.shape, [*inputs, REACH, *outputs], device="cpu", record_tape=False)
    column, beam = np.nonzero(ranges > NEAREST)
    noise = np.random.default_rng((seed, index, 1)).normal(0, RANGE_NOISE, len(column))
    far = ranges[column, beam] + noise
    local = directions[column, beam] * far[:, None]
    rotation, origin = world_from_sensor[column, :3, :3], world_from_sensor[column, :3, 3]
    points = np.einsum("nij,nj->ni", rotation, local) + origin
    end = start + PERIOD
    return LidarSweep(
        points=points.astype(np.float32),
        times=times[column],
        origin=(ego.at(end) @ EGO_FROM_SENSOR)[:3, 3],
        time=end,
        frame_index=index,
        labels=labels[column, beam],
    )


def _directions(azimuths: NDArray) -> NDArray[np.float32]:
    """[A, B, 3] unit, in the sensor's frame."""
    a, e = azimuths[:, None], ELEVATIONS[None]
    flat = np.cos(e)
    return np.stack([flat * np.cos(a), flat * np.sin(a), np.sin(e) + 0 * a], -1).astype(np.float32)
