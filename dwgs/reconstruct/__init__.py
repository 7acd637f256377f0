"""Scene -> Background: the static street as Gaussians, frozen once it is fitted."""

from dwgs.reconstruct.config import ReconstructConfig as ReconstructConfig
from dwgs.reconstruct.fit import reconstruct as reconstruct
from dwgs.reconstruct.moving_mask import moving_mask as moving_mask
