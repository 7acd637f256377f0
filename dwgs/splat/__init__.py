"""Gaussians x Camera -> Rendering, differentiable."""

from dwgs.splat.capture import capture as capture
from dwgs.splat.ops.composite import composite as composite
from dwgs.splat.ops.project import project as project
from dwgs.splat.ops.render import render as render
from dwgs.splat.retained import Drawing as Drawing
from dwgs.splat.retained import Picture as Picture
from dwgs.splat.retained import RetainedCloud as RetainedCloud
from dwgs.splat.splats import Layers as Layers
from dwgs.splat.splats import Objects as Objects
from dwgs.splat.splats import Projected as Projected
from dwgs.splat.splats import Rendering as Rendering
from dwgs.splat.splats import Splats as Splats
from dwgs.splat.splats import View as View
