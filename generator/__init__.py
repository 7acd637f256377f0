"""Video with a vehicle that was never there: conditions, backends, and what they share."""

from generator.generator import Capabilities as Capabilities
from generator.generator import Generator as Generator
from generator.generator import backend as backend
