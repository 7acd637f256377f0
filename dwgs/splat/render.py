"""The whole way: project, bin, composite."""

from dwgs.splat.ops.composite import composite
from dwgs.splat.ops.project import project
from dwgs.splat.splats import Layers, Rendering, Splats, View


def render(splats: Splats, view: View, layers: Layers | None = None, threads: int = 2) -> Rendering:
    """The image of ``splats`` in ``view``; a gradient flows to every field of both."""
    return composite(project(splats, view, threads), view, layers, threads)
