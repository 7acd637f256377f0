"""What there is to see, and where it is at a given time."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from dwgs.scene import Background, Gaussians, InputError, Trajectory, VehicleAsset


@dataclass(frozen=True)
class SceneGraph:
    """A street, or none, and vehicles on their ways through it."""

    background: Background | None
    """Stays where it is; its sky is drawn behind everything."""
    actors: Sequence[tuple[VehicleAsset, Trajectory]] = ()
    """Any number; one asset may drive twice. An actor is there while its trajectory covers the time."""
    backdrop: NDArray[np.float32] = field(default_factory=lambda: np.zeros((1, 1, 3), np.float32))
    """[H, W, 3] the sky where there is no background, laid out like `Background.sky`; black if not given."""

    def __post_init__(self) -> None:
        if self.backdrop.ndim != 3 or self.backdrop.shape[2] != 3 or self.backdrop.dtype != np.float32:
            raise InputError(
                f"a backdrop is a float32 image [H, W, 3], got {self.backdrop.dtype} {self.backdrop.shape}"
            )

    @property
    def sky(self) -> NDArray[np.float32]:
        """[H, W, 3] what lies behind all Gaussians."""
        return self.backdrop if self.background is None else self.background.sky

    def clouds_at(self, time: float) -> list[tuple[Gaussians, NDArray[np.float64]]]:
        """Every cloud there is at ``time`` [s], with its ``world_from_cloud`` [4, 4].

        The clouds are the very objects of the background and the assets: a renderer knows them again. A vehicle that
        the sun lights anew is another at every heading, and so is its shadow; a wheel is wherever it drives.
        """
        clouds = [] if self.background is None else [(self.background.gaussians, np.eye(4))]
        for asset, trajectory in self.actors:
            if trajectory.covers(time):
                world_from_vehicle = trajectory.at(time)
                parts = [asset.shadow_at(world_from_vehicle), *asset.parts_at(trajectory, time)]
                clouds += [(part, world_from_vehicle) for part in parts]
        return [(cloud, world_from_cloud) for cloud, world_from_cloud in clouds if len(cloud)]
