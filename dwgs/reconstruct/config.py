"""How a street is reconstructed."""

from dataclasses import dataclass

from dwgs.optimize import Rates


@dataclass(frozen=True)
class ReconstructConfig:
    """What may be asked of a reconstruction. The same values and input give the same bytes."""

    steps: int = 2400
    """Length of the schedule. Never stop early: the rates fall, and quality rises, at its end."""
    gaussians: int = 160_000
    """At most so many are laid on the LiDAR points; the sky, gaps and growth come on top."""
    grown: int = 40_000
    """How many are added each time the cloud grows."""
    threads: int = 2
    """How many threads composite one image."""
    seed: int = 0
    """Chooses the points that are kept and the pixels that grow."""

    @staticmethod
    def draft(seed: int = 0) -> "ReconstructConfig":
        """A quick street with half the Gaussians and a tenth of the steps: softer everywhere."""
        return ReconstructConfig(steps=250, gaussians=80_000, grown=20_000, seed=seed)

    @staticmethod
    def joint(seed: int = 0) -> "ReconstructConfig":
        """Street and traffic together: more Gaussians and a longer schedule."""
        return ReconstructConfig(steps=3600, gaussians=240_000, grown=60_000, seed=seed)


RATES = Rates(means=2e-3, quats=6e-3, scales=2e-2, opacities=0.1, sh_dc=1.5e-2, sh_rest=3e-3, betas=(0.9, 0.99))
"""About three times the usual: the schedule is short."""
UNIT_DISTANCE = 10.0
"""The rate of the means holds at this distance from the nearest camera [m], and grows in proportion."""
NEAREST = 3.0
"""Nothing moves as if it were nearer than this [m]."""
