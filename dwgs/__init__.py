"""Put a vehicle into a recorded drive, and take it home as 3D Gaussians."""

import os

__version__ = "0.1.0"

# Idle OpenMP workers of torch spin by default and take the cores from the splatter's own threads: a step of a fit
# on two cores is four times slower. OpenMP reads this when torch is loaded, so it stands before everything.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
