"""Street trees: a trunk and a crown of lumps."""

import numpy as np
import trimesh

from dwgs.street.material import BARK, LEAVES, Material, Palette
from dwgs.street.shape import Shape

GREENS = (
    ((58, 82, 34), (128, 150, 62)), ((48, 76, 38), (104, 140, 66)),
    ((78, 92, 36), (156, 160, 70)), ((62, 74, 30), (136, 138, 56)),
)  # fmt: skip


def build_tree(palette: Palette, rng: np.random.Generator) -> Shape:
    """A tree at the origin, 5 to 8 m tall."""
    dark, bright = GREENS[rng.integers(len(GREENS))]
    leaves = palette.add(Material(dark, LEAVES, bright))
    bark = palette.add(Material((96, 82, 68), BARK))
    height = float(rng.uniform(2.3, 2.9))
    spread = float(rng.uniform(1.2, 1.6))
    profile = [
        [0.0, 0.0],
        [0.22, 0.0],
        [0.14, 0.5],
        [0.11, height],
        [0.05, height + 1.8],
        [0.0, height + 1.8],
    ]
    pieces = [Shape.of(trimesh.creation.revolve(profile, sections=9), bark, smooth=True)]
    for k in range(3):
        angle = 2.1 * k + rng.uniform(0, 1)
        tip = [0.9 * spread * np.cos(angle), 0.9 * spread * np.sin(angle), height + 1.2]
        branch = trimesh.creation.cylinder(radius=0.05, segment=[[0, 0, height - 0.3], tip], sections=6)
        pieces.append(Shape.of(branch, bark, smooth=True))
    centre = np.array([0, 0, height + 1.5 * spread])
    for k in range(7):
        angle, lift = 2.4 * k + rng.uniform(-0.3, 0.3), rng.uniform(-0.45, 0.75)
        reach = 0.75 * spread if k else 0.0
        offset = [reach * np.cos(angle), reach * np.sin(angle), lift * spread]
        pieces.append(_lump(leaves, centre + offset, spread * rng.uniform(0.62, 0.88), rng))
    return Shape.join(pieces)


def _lump(material: int, centre: np.ndarray, radius: float, rng: np.random.Generator) -> Shape:
    """A ball beaten out of shape: swells and dents by waves of random directions."""
    ball = trimesh.creation.icosphere(subdivisions=2)
    waves = rng.normal(size=(10, 3)) * np.linspace(2, 9, 10)[:, None]
    phases = rng.uniform(0, 2 * np.pi, 10)
    dents = np.sin(ball.vertices @ waves.T + phases) @ np.linspace(0.10, 0.035, 10)
    ball.vertices *= (radius * (1 + dents))[:, None] * [1, 1, 0.86]
    ball.vertices += centre
    return Shape.of(ball, material, smooth=True)
