"""A recorded (or generated) drive."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from dwgs.scene.camera import Camera
from dwgs.scene.errors import InputError
from dwgs.scene.lidar import LidarSweep
from dwgs.scene.track import Track
from dwgs.scene.trajectory import Trajectory


@dataclass(frozen=True)
class Frame:
    """One image of one camera: where it was taken from, and how to get its pixels."""

    index: int
    """Number of the frame in the recording; the cameras and the sweep of one instant share it."""
    camera_name: str
    """Which camera of the rig."""
    camera: Camera
    """Where, when and how."""
    load_pixels: Callable[[], NDArray[np.uint8]] = field(repr=False, compare=False)
    """Reads the image [H, W, 3] sRGB; the size is the camera's."""
    load_reactive_mask: Callable[[], NDArray[np.bool_]] | None = field(default=None, repr=False, compare=False)
    """Reads the reactive mask [H, W] (True where a generator put what was not there), or None for a recorded frame."""

    @property
    def pixels(self) -> NDArray[np.uint8]:
        """[H, W, 3] sRGB, read anew each time."""
        pixels = self.load_pixels()
        if pixels.shape != (self.camera.height, self.camera.width, 3) or pixels.dtype != np.uint8:
            raise InputError(
                f"frame {self.index} of {self.camera_name} is {pixels.dtype} {pixels.shape} "
                f"but its camera says {self.camera.width}x{self.camera.height}"
            )
        return pixels

    @property
    def reactive_mask(self) -> NDArray[np.bool_] | None:
        """[H, W], or None for a recorded frame."""
        return self.load_reactive_mask() if self.load_reactive_mask else None


@dataclass(frozen=True)
class Scene:
    """A drive: what the cameras saw, where they were, what the LiDAR hit, who else was on the road."""

    name: str
    """For people."""
    frames: dict[str, tuple[Frame, ...]]
    """Camera name to its frames in order of time. The first camera is the main one."""
    ego: Trajectory
    """Pose of the recording car: x forward, y left, z up; the origin is the recording's own."""
    sweeps: tuple[LidarSweep, ...] = ()
    """In order of time; a frame may lack its sweep."""
    tracks: tuple[Track, ...] = ()
    """Recorded vehicles and people, each once."""

    def __post_init__(self) -> None:
        if not self.frames or not all(self.frames.values()):
            raise InputError(f"a scene has at least one camera with at least one frame, '{self.name}' has none")

    @property
    def main_camera(self) -> str:
        """Name of the first camera."""
        return next(iter(self.frames))

    def all_frames(self) -> list[Frame]:
        """Frames of every camera, camera by camera."""
        return [frame for frames in self.frames.values() for frame in frames]

    def track(self, id: str) -> Track:
        """The track of that id, or of the one id that begins so."""
        found = [t for t in self.tracks if t.id == id] or [t for t in self.tracks if t.id.startswith(id)]
        if len(found) != 1:
            some = ", ".join(t.id for t in self.tracks if t.is_vehicle)[:400]
            raise InputError(f"'{id}' names {len(found)} tracks of '{self.name}', not one; vehicles here: {some}")
        return found[0]

    def select(self, cameras: list[str] | None = None, frames: range | None = None) -> "Scene":
        """Only these cameras (in this order) and only the frames whose index lies in the range."""
        for name in cameras or []:
            if name not in self.frames:
                raise InputError(f"'{self.name}' has no camera '{name}'; it has {', '.join(self.frames)}")
        kept = {name: self.frames[name] for name in cameras or self.frames}
        if frames is not None:
            kept = {name: tuple(f for f in fs if f.index in frames) for name, fs in kept.items()}
            if not all(kept.values()):
                have = self.frames[next(iter(kept))]
                raise InputError(
                    f"no frame of '{self.name}' lies in {frames.start}-{frames.stop - 1}; "
                    f"it has {have[0].index}-{have[-1].index}"
                )
        return replace(self, frames=kept)
