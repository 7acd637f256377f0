"""dwgs inspect: one picture of what a recording holds."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from dwgs.cli.options import ClipOptions
from dwgs.cli.progress import say


@dataclass(frozen=True)
class Inspect:
    """Draw LiDAR, boxes, camera path and splat centres; list the tracks that can be distilled."""

    clip: ClipOptions
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("inspect.png")
    """Picture to write (PNG)."""
    gaussians: Path | None = None
    """Background or asset folder, or PLY, whose centres to draw as well."""

    def run(self) -> None:
        """Leave a picture."""
        from dwgs.formats import ply
        from dwgs.inspect import inspect

        scene = self.clip.open()
        path = self.gaussians
        cloud = ply.read(path / "gaussians.ply" if path.is_dir() else path) if path else None
        inspect(scene, self.out, cloud)
        frames = scene.frames[scene.main_camera]
        say(f"{scene.name}: {len(frames)} frames, {len(scene.sweeps)} sweeps, {scene.ego.length:.1f} m driven")
        for track in sorted(scene.tracks, key=lambda t: (not t.is_moving, t.category)):
            if track.is_vehicle:
                size = " x ".join(f"{s:.2f}" for s in track.size)
                say(f"  {track.id}  {'moves ' if track.is_moving else 'parked'}  {track.category} {size} m")
        say(f"wrote {self.out}")
