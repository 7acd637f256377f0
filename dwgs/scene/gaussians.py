"""A cloud of 3D Gaussians, activated."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dwgs.scene.errors import InputError

SH_COUNTS = (1, 4, 9, 16)
"""Coefficients per channel for spherical harmonics of degree 0 to 3."""


@dataclass(frozen=True)
class Gaussians:
    """float32 arrays as they are rendered: metres and probabilities, no logs, no logits."""

    means: NDArray[np.float32]
    """[N, 3] [m]."""
    quats: NDArray[np.float32]
    """[N, 4] wxyz, unit."""
    scales: NDArray[np.float32]
    """[N, 3] standard deviations [m], positive."""
    opacities: NDArray[np.float32]
    """[N] in [0, 1]."""
    sh: NDArray[np.float32]
    """[N, K, 3] real spherical harmonics in this cloud's frame, DC first, K of `SH_COUNTS`.

    Colour = 0.5 + sum, sRGB.
    """

    def __post_init__(self) -> None:
        n = len(self.means)
        shapes = {"means": (n, 3), "quats": (n, 4), "scales": (n, 3), "opacities": (n,)}
        for name, shape in shapes.items():
            if getattr(self, name).shape != shape:
                raise InputError(f"Gaussians.{name} has shape {shape}, got {getattr(self, name).shape}")
        if self.sh.ndim != 3 or self.sh.shape[0] != n or self.sh.shape[1] not in SH_COUNTS or self.sh.shape[2] != 3:
            raise InputError(f"Gaussians.sh has shape ({n}, 1|4|9|16, 3), got {self.sh.shape}")
        for name in (*shapes, "sh"):
            if getattr(self, name).dtype != np.float32:
                raise InputError(f"Gaussians.{name} is float32, got {getattr(self, name).dtype}")

    def __len__(self) -> int:
        return len(self.means)

    def __getitem__(self, index) -> "Gaussians":
        """The Gaussians that a NumPy index or mask over [N] selects."""
        return Gaussians(*(getattr(self, f)[index] for f in ("means", "quats", "scales", "opacities", "sh")))

    def mirrored(self) -> "Gaussians":
        """Their mirror images about the plane y = 0, where left is right."""
        degrees = [degree for degree in range(4) for _ in range(2 * degree + 1)][: self.sh.shape[1]]
        is_odd = [k - degree**2 < degree for k, degree in enumerate(degrees)]  # a factor of y, or of y^3
        return Gaussians(
            self.means * np.array([1, -1, 1], np.float32),
            self.quats * np.array([1, -1, 1, -1], np.float32),
            self.scales,
            self.opacities,
            self.sh * np.where(is_odd, np.float32(-1), np.float32(1))[:, None],
        )

    @property
    def sh_degree(self) -> int:
        """0 to 3."""
        return SH_COUNTS.index(self.sh.shape[1])

    @staticmethod
    def concatenate(clouds: "list[Gaussians]") -> "Gaussians":
        """One cloud of several in the same frame; lower SH degrees are padded with zeros."""
        count = max(g.sh.shape[1] for g in clouds)
        padded = [np.pad(g.sh, ((0, 0), (0, count - g.sh.shape[1]), (0, 0))) for g in clouds]
        fields = ("means", "quats", "scales", "opacities")
        joined = {f: np.concatenate([getattr(g, f) for g in clouds]) for f in fields}
        return Gaussians(**joined, sh=np.concatenate(padded))

    @staticmethod
    def empty(sh_degree: int = 0) -> "Gaussians":
        """No Gaussians at all."""
        shapes = ((0, 3), (0, 4), (0, 3), (0,), (0, SH_COUNTS[sh_degree], 3))
        return Gaussians(*(np.zeros(shape, np.float32) for shape in shapes))
