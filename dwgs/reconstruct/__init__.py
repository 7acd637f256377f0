"""Scene -> Background: the static street as Gaussians, frozen once it is fitted; or all of it, traffic too."""

from dwgs.reconstruct.config import ReconstructConfig as ReconstructConfig
from dwgs.reconstruct.fit import reconstruct as reconstruct
from dwgs.reconstruct.joint import INSERTED as INSERTED
from dwgs.reconstruct.joint import reconstruct_jointly as reconstruct_jointly
from dwgs.reconstruct.moving_mask import moving_mask as moving_mask
from dwgs.reconstruct.reconstruction import Reconstruction as Reconstruction
from dwgs.reconstruct.traffic import Actor as Actor
