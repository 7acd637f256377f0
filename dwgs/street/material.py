"""What surfaces are made of, and the palette that numbers them."""

from dataclasses import dataclass, field

import numpy as np
import warp as wp

from dwgs.scene.lidar import SURFACES

PLAIN, ASPHALT, SLABS, BRICK, PLASTER, LEAVES, BARK, SHOP, GRASS = range(9)
"""Procedural patterns of `dwgs.street.surface`."""

GROUND = SURFACES.index("ground")
STATIC = SURFACES.index("static")
VEHICLE = SURFACES.index("vehicle")


@dataclass(frozen=True)
class Material:
    """One look: a pattern, its colours, and what a LiDAR would call it."""

    color: tuple[int, int, int]
    """sRGB, what most of it looks like in white light."""
    pattern: int = PLAIN
    """Which procedure draws it."""
    accent: tuple[int, int, int] = (0, 0, 0)
    """sRGB of the second colour: window frames, joints, dead leaves."""
    mirror: float = 0.0
    """Share of light it mirrors at normal incidence; 0 is matt."""
    surface: int = STATIC
    """Index into `SURFACES`."""
    windows: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """(bay width, storey height, height of the ground floor) [m]; no windows where the bay is 0."""
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Where its pattern starts [m]."""


@wp.struct
class Look:
    """A `Material` as kernels read it: linear colours."""

    color: wp.vec3
    accent: wp.vec3
    origin: wp.vec3
    windows: wp.vec3
    mirror: float
    pattern: int
    surface: int


@dataclass
class Palette:
    """Numbers materials; equal ones share a number."""

    rows: dict[Material, int] = field(default_factory=dict)
    """Material to number, in order."""

    def add(self, material: Material) -> int:
        """The number of this material."""
        return self.rows.setdefault(material, len(self.rows))

    def looks(self) -> wp.array:
        """The rows as kernels read them."""
        rows = []
        for m in self.rows:
            look = Look()
            look.color, look.accent = wp.vec3(*linear(m.color)), wp.vec3(*linear(m.accent))
            look.origin, look.windows = wp.vec3(*m.origin), wp.vec3(*m.windows)
            look.mirror, look.pattern, look.surface = m.mirror, m.pattern, m.surface
            rows.append(look)
        return wp.array(rows, dtype=Look, device="cpu")

    def colors(self) -> np.ndarray:
        """[M, 3] uint8 sRGB."""
        return np.array([m.color for m in self.rows], np.uint8)


def linear(srgb: tuple[int, int, int]) -> np.ndarray:
    """Linear [3] in [0, 1] of an sRGB colour of bytes (IEC 61966-2-1)."""
    c = np.asarray(srgb, np.float64) / 255
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)
