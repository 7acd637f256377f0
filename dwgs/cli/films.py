"""Films for people: before, after, and the asset turning."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from dwgs.cli.progress import Bar, OnProgress
from dwgs.cli.stage import StageRecord, kept, measured, read_record, stage_key, write_record
from dwgs.scene import Frame, Scene, Trajectory, VehicleAsset

ORBIT_FRAMES = 48
ORBIT_FPS = 16.0
FILMS = ("before.mp4", "after.mp4", "orbit.mp4")


def film_stage(out: Path, recorded: Scene, edited: Scene, asset: VehicleAsset, key: str) -> StageRecord:
    """Write the films into ``out``; ``key`` is that of the asset's stage, on which all of them depend."""
    from dwgs.video import write_mp4

    record_path = out / ".films.json"
    key = stage_key("films", {"asset": key})
    former = read_record(record_path)
    if former is not None and former.key == key and all((out / name).exists() for name in FILMS):
        return kept(former, "films")

    def work(progress: Bar) -> dict:
        for name, scene in zip(FILMS[:2], (recorded, edited), strict=True):
            frames = scene.frames[scene.main_camera]
            write_mp4(out / name, (frame.pixels for frame in counted(frames, progress.count)), fps(frames))
        write_mp4(out / FILMS[2], orbit(asset, progress.count), ORBIT_FPS)
        return {}

    record = measured(key, "films", work)
    write_record(record, record_path)
    return record


def orbit(asset: VehicleAsset, on_progress: OnProgress) -> Iterator[np.ndarray]:
    """The asset alone, turning once: uint8 images [H, W, 3]."""
    from viewer.orbit import BACKDROP, orbit_cameras
    from viewer.renderer import Renderer
    from viewer.scene_graph import SceneGraph

    cameras = orbit_cameras(asset, ORBIT_FRAMES, 720, 480)
    still = Trajectory(np.zeros(1), np.eye(4)[None])
    at_rest = replace(asset, casting=None)  # there is no street here, and no sun: the shadow lies as it was seen
    graph = SceneGraph(None, [(at_rest, still)], backdrop=BACKDROP)
    with Renderer(cameras[0].width, cameras[0].height) as renderer:
        for camera in counted(cameras, on_progress):
            yield to_uint8(renderer.render(graph, camera).rgb)


def counted(items: Sequence, on_progress: OnProgress) -> Iterator:
    """The items, counted as they are taken."""
    for i, item in enumerate(items):
        yield item
        on_progress(i + 1, len(items))


def fps(frames: Sequence[Frame]) -> float:
    """Of a film that plays as fast as it was recorded [1/s]."""
    if len(frames) < 2:
        return 10.0
    return (len(frames) - 1) / (frames[-1].camera.time - frames[0].camera.time)


def to_uint8(rgb: np.ndarray) -> np.ndarray:
    """sRGB in [0, 1], rounded to bytes."""
    return (np.clip(rgb, 0, 1) * 255 + 0.5).astype(np.uint8)
