"""The light of a recorded drive: what surrounds the road, how bright that makes the ground, the sun."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, map_coordinates

from dwgs.scene import Frame, LidarSweep, Scene
from dwgs.scene.color import linear_from_srgb, luminance
from generator.composite.sun import find_sun

ROWS, COLUMNS = 48, 96
"""Size of the panorama: cells of 3.75 degrees, finer than any reflection on paint needs."""
ROAD_ALBEDO = 0.12
"""Worn asphalt reflects about so much; it is what tells exposure and white balance."""
WHITE_LEVEL = 1.4
"""A camera is exposed so that white ground in full light is at most so bright; where asphalt says more, it is pale."""
LOOKS = 12
"""Frames per camera that are looked at, spread evenly over the clip."""
SUN_LOOKS = 6
"""Frames in which shadows are compared with the sun's direction."""
STRIDE = 3
"""Every so many pixels are taken for the panorama."""


@dataclass(frozen=True)
class Environment:
    """Light in the units of the recorded pixels: linear, exposure and white balance included."""

    panorama: NDArray[np.float32]
    """[ROWS, COLUMNS, 3] radiance without the sun, laid out as `Background.sky`."""
    ground: NDArray[np.float32]
    """[3] what a white, flat, unshaded ground would look like under sky alone."""
    sun_direction: NDArray[np.float32] | None
    """[3] unit, towards the sun, world frame; None under an overcast sky or between tall houses."""
    sun: NDArray[np.float32]
    """[3] what the sun adds to a white disc that faces it."""
    black: float
    """Darkest linear value that the camera's haze and flare leave."""

    def radiance(self, directions: NDArray) -> NDArray[np.float32]:
        """[..., 3] seen along world directions [..., 3], bilinear."""
        x, y, z = np.moveaxis(directions, -1, 0)
        row = np.arccos(np.clip(z, -1, 1)) / np.pi * ROWS - 0.5
        column = (np.arctan2(y, x) / (2 * np.pi) + 0.5) * COLUMNS - 0.5
        wrapped = np.pad(self.panorama, ((1, 1), (0, 0), (0, 0)), mode="edge")
        wrapped = np.pad(wrapped, ((0, 0), (1, 1), (0, 0)), mode="wrap")
        at = np.stack([row + 1, column + 1])
        colors = [map_coordinates(wrapped[..., c], at, order=1, mode="nearest") for c in range(3)]
        return np.stack(colors, -1).astype(np.float32)


def look_around(scene: Scene) -> Environment:
    """The environment that the frames of a drive show."""
    frames = [f for fs in scene.frames.values() for f in _spread(fs)]
    sweeps = {s.frame_index: s for s in scene.sweeps}
    total, count = np.zeros((ROWS, COLUMNS, 3)), np.zeros((ROWS, COLUMNS))
    roads, darkest = [], []
    for frame in frames:
        pixels = linear_from_srgb(frame.pixels / np.float32(255))
        _add(total, count, frame, pixels)
        darkest.append(np.quantile(luminance(pixels[::STRIDE, ::STRIDE]), 0.005))
        if frame.index in sweeps:
            roads.append(_road_pixels(frame, pixels, sweeps[frame.index], scene))
    sun = find_sun(scene, frames[:: -(-len(frames) // SUN_LOOKS)])
    road = np.median(np.concatenate(roads), axis=0) if roads and sum(map(len, roads)) else np.full(3, 0.1)
    panorama = _complete(total, count, road)
    black = 0.7 * float(np.median(darkest))
    none = np.zeros(3, np.float32)
    brightest = road if sun is None else sun.sunlit
    albedo = np.float32(max(ROAD_ALBEDO, luminance(brightest) / WHITE_LEVEL))
    if sun is None:
        return Environment(panorama, (road / albedo).astype(np.float32), None, none, black)
    direct = (sun.sunlit - sun.shaded) / (albedo * sun.direction[2])
    return Environment(panorama, sun.shaded / albedo, sun.direction, direct, black)


def _spread(frames: tuple[Frame, ...]) -> list[Frame]:
    chosen = np.unique(np.linspace(0, len(frames) - 1, min(LOOKS, len(frames))).round().astype(int))
    return [frames[i] for i in chosen]


def _add(total: NDArray, count: NDArray, frame: Frame, pixels: NDArray) -> None:
    """Accumulate a frame's pixels by the world direction they come from."""
    camera = frame.camera
    v, u = np.mgrid[STRIDE // 2 : camera.height : STRIDE, STRIDE // 2 : camera.width : STRIDE]
    rays = np.stack([u + 0.5, v + 0.5, np.ones(u.shape)], -1) @ np.linalg.inv(camera.K).T
    rays = rays @ camera.world_from_camera[:3, :3].T
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    row = np.clip((np.arccos(rays[..., 2]) / np.pi * ROWS).astype(int), 0, ROWS - 1)
    column = ((np.arctan2(rays[..., 1], rays[..., 0]) / (2 * np.pi) + 0.5) * COLUMNS).astype(int) % COLUMNS
    np.add.at(total, (row, column), pixels[v, u])
    np.add.at(count, (row, column), 1)


def _road_pixels(frame: Frame, pixels: NDArray, sweep: LidarSweep, scene: Scene) -> NDArray[np.float32]:
    """Linear colours [P, 3] of the ground that the LiDAR hit near the recording car."""
    camera = frame.camera
    points = sweep.points[np.hypot(*(sweep.points[:, :2] - camera.position[:2]).T) < 25]
    if len(points) == 0:
        return np.zeros((0, 3), np.float32)
    floor = np.quantile(points[:, 2], 0.05)
    uv, depth = camera.project(points[np.abs(points[:, 2] - floor) < 0.35])
    x, y = np.floor(np.where(depth[:, None] > 1, uv, -1)).astype(int).T
    inside = (x >= 0) & (x < camera.width) & (y >= 0) & (y < camera.height)
    return pixels[y[inside], x[inside]]


def _complete(total: NDArray, count: NDArray, road: NDArray) -> NDArray[np.float32]:
    """The panorama with what no frame showed: azimuths as the mean of their row, the zenith as the top row."""
    seen = count > 0
    mean = total / np.maximum(count, 1)[..., None]
    rows = seen.sum(1)
    elevation = np.pi / 2 - (np.arange(ROWS) + 0.5) * np.pi / ROWS
    row_mean = total.sum(1) / np.maximum(count.sum(1), 1)[:, None]
    above = np.flatnonzero((elevation > 0) & (rows > 0))
    top = above[0] if len(above) else ROWS // 2
    brightest = mean[top][seen[top]]
    zenith = np.quantile(brightest, 0.75, axis=0) if len(brightest) else road / ROAD_ALBEDO
    row_mean[elevation > elevation[top]] = zenith
    fade = np.clip((elevation[:top] - elevation[top]) / 0.5, 0, 1)[:, None, None]
    panorama = np.where(seen[..., None], mean, row_mean[:, None])
    panorama[:top] = fade * zenith + (1 - fade) * np.where(seen[top][:, None], mean[top], zenith)
    panorama[elevation < -0.03] = road
    smooth = gaussian_filter1d(gaussian_filter1d(panorama, 0.8, axis=0, mode="nearest"), 1.2, axis=1, mode="wrap")
    return np.asarray(smooth, np.float32)
