"""dwgs render: pictures of background and assets."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from dwgs.cli.films import counted, fps, to_uint8
from dwgs.cli.options import ClipOptions, PlacementOptions
from dwgs.cli.progress import bar, say
from dwgs.cli.reconstruct import TRAJECTORY_FILE
from dwgs.scene import Background, Camera, Frame, Trajectory, VehicleAsset
from dwgs.scene.pose import pose


@dataclass(frozen=True)
class Render:
    """Render the reconstructed street through the recorded cameras, with or without assets in it."""

    clip: ClipOptions
    background: Path
    """Folder from `dwgs reconstruct`."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Film to write (.mp4, or .avi without loss)."""
    placement: PlacementOptions
    asset: tuple[Path, ...] = ()
    """Asset folders, each on the trajectory it was distilled on unless another is given; none shows the
    empty street."""
    move: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Carry the assets forward, left and up of where they would be [m]."""

    def run(self) -> None:
        """Leave a film."""
        from dwgs.formats import asset_folder, background_folder
        from dwgs.video import write_lossless, write_mp4
        from viewer.renderer import Renderer
        from viewer.scene_graph import SceneGraph

        scene = self.clip.open()
        background = background_folder.read(self.background)
        actors = []
        for folder in self.asset:
            if self.placement.is_given:
                asset = asset_folder.read(folder)
                trajectory = self.placement.drive(scene, asset.size)
            else:
                asset, trajectory = read_driven(folder)
            actors.append((asset, carried(trajectory, self.move)))
        frames = scene.frames[scene.main_camera]
        renderer = Renderer(frames[0].camera.width, frames[0].camera.height)
        graph = SceneGraph(background, actors)
        with bar("render") as progress:
            pictures = (rendered(renderer, graph, background, frame) for frame in counted(frames, progress.count))
            write = write_lossless if self.out.suffix == ".avi" else write_mp4
            write(self.out, pictures, fps(frames))
        say(f"wrote {self.out}")


def read_driven(folder: Path) -> tuple[VehicleAsset, Trajectory]:
    """An asset, and where it drove in the scene it comes from."""
    from dwgs.formats import asset_folder
    from dwgs.scene.trajectory_file import read_trajectory

    asset = asset_folder.read(folder)
    return asset, read_trajectory(folder / TRAJECTORY_FILE, asset.size)


def carried(trajectory: Trajectory, move: tuple[float, float, float]) -> Trajectory:
    """The same drive, displaced in the vehicle's own frame."""
    return replace(trajectory, world_from_vehicle=trajectory.world_from_vehicle @ pose(np.eye(3), move))


def refined(background: Background, frame: Frame) -> Camera:
    """The frame's camera where the background was fitted with it."""
    pose = background.poses.get((frame.camera_name, frame.index))
    return frame.camera if pose is None else frame.camera.at(pose)


def rendered(renderer, graph, background: Background, frame: Frame) -> np.ndarray:
    """What the frame's camera sees of the graph, uint8 [H, W, 3]."""
    rgb = renderer.render(graph, refined(background, frame)).rgb
    rgb = rgb * background.exposure.get(frame.camera_name, np.ones(3, np.float32))
    return to_uint8(rgb)
