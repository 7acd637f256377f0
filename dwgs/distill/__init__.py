"""A vehicle that a scene shows, taken out of it as Gaussians in its own frame; the background is frozen."""

from dwgs.distill.config import DistillConfig as DistillConfig
from dwgs.distill.fit import Distilled as Distilled
from dwgs.distill.fit import distill as distill
from dwgs.distill.layers import Frozen as Frozen
from dwgs.distill.layers import FrozenBackground as FrozenBackground
from dwgs.distill.layers import FrozenView as FrozenView
from dwgs.distill.traffic import others as others
