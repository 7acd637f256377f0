"""How a distillation is run, and the two recipes that were measured."""

from dataclasses import dataclass
from functools import partial

from dwgs.optimize import Rates


@dataclass(frozen=True)
class DistillConfig:
    """What may be asked of a distillation. The same values and input give the same bytes."""

    steps: int = 1200
    """Length of the schedule. Never stop early: the rates fall, and quality rises, at its end."""
    seconds: float | None = None
    """Time for preparing and fitting [s]: as many frames teach and the schedule is as long as fits, ``steps`` count no
    more, and what comes out depends on the machine."""
    gaussians: int = 20_000
    """At most so many on the vehicle's body; fewer in a short time."""
    shadow_margin: float = 2.5
    """How far around the box a shadow is looked for [m]; 0: there is none."""
    lidar_weight: float = 0.02
    """Weight of the relative LiDAR depth error, outside reactive masks; 0 leaves it out."""
    symmetry: bool = True
    """Sides that no frame shows look as the other side does, in the same light; else as the points. A scan is
    mirrored anyway."""
    threads: int = 2
    """How many frames are prepared at once, and how many threads composite one."""
    seed: int = 0
    """Chooses the order of the views."""


@dataclass(frozen=True, kw_only=True)
class PathPrior:
    """What is known of where a vehicle drives before its pictures are seen; angles first, then places."""

    jerk: tuple[float, float]
    """Third derivative of its path, as a vehicle has it [rad/s^3, m/s^3]; a path that trembles says so itself."""
    slack: tuple[float, float]
    """How far it may be off [rad, m], however smooth it is."""
    coherence: float
    """How many pixels err together, and count as one: a model that is not done yet is wrong in large patches. Of noise
    in made-up paths 1.0 cm is left along the drive with 30,000, 1.3 with 10,000, 1.1 with 100,000."""


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """Settings that depend on what made the pixels."""

    body: Rates
    shadow: Rates
    hold: float
    """Fraction of the schedule at full rates; after it they fall exponentially."""
    final: float
    """Factor on the rates at the end."""
    robust: bool
    """L1 with D-SSIM, which forgive what no rigid car explains; else squared error, views by its logarithm."""
    path: PathPrior
    refines_poses: bool
    """Whether boxes were annotated and may be off by centimetres; a generated vehicle is where it was put, unless its
    path trembles."""
    visible: float
    """Frames that show a smaller part of the vehicle's points are left out."""


STILLNESS = 0.1
"""Costs 0.1 dB where cameras looked; without it the sides that none saw turn into coloured noise."""

_shadow = partial(Rates, quats=1e-2, sh_rest=0.0, stillness=STILLNESS)

GENERATED = Recipe(
    body=Rates(
        means=1.8e-3,
        quats=1.5e-2,
        scales=6.5e-2,
        opacities=0.11,
        sh_dc=6.2e-2,
        sh_rest=7e-3,
        betas=(0.85, 0.95),
        amplified=("means", "quats", "scales"),
        stillness=STILLNESS,
    ),
    shadow=_shadow(
        means=6e-3,
        scales=6e-2,
        opacities=0.07,
        sh_dc=5e-2,
        betas=(0.8, 0.95),
        amplified=("scales", "sh"),
    ),
    hold=0.4,
    final=0.05,
    robust=False,
    path=PathPrior(jerk=(0.5, 2.0), slack=(1e-3, 5e-3), coherence=3e4),
    refines_poses=False,
    visible=0.0,
)
"""For clean video whose geometry is exact. What follows the trend of its gradients (``amplified``) is worth 0.3 dB
after 2,400 steps. Opacities lose 0.6 dB by it, and colours of a body that begin far off 4 dB where frames are few.
Shadows whose places follow theirs, too, are worth 0.1 dB more before the street as it is, but before a reconstruction
they explain what that has wrong: the vehicle has 0.9 dB less on its pixels."""

RECORDED = Recipe(
    body=Rates(
        means=2e-3,
        quats=1.6e-2,
        scales=4e-2,
        opacities=0.1,
        sh_dc=4e-2,
        sh_rest=1e-2,
        betas=(0.9, 0.99),
        amplified=("means", "quats", "scales", "sh"),
        stillness=STILLNESS,
    ),
    shadow=_shadow(means=4e-3, scales=3e-2, opacities=0.1, sh_dc=2e-2, betas=(0.9, 0.99)),
    hold=0.5,
    final=0.05,
    robust=True,
    path=PathPrior(jerk=(2.0, 8.0), slack=(0.02, 0.1), coherence=1e3),
    refines_poses=True,
    visible=0.3,
)
"""For a car that a camera saw: annotated boxes, turning wheels, reflections. Of eight of a drive, holding the rates is
worth 0.09 dB held-out after 1,200 steps on average, trends a further 0.03; 0.3 and 0.2 dB for one that overtakes."""
