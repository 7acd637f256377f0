"""The whole way: project, bin, composite."""

from torch import Tensor

from dwgs.splat.ops.composite import composite
from dwgs.splat.ops.project import project
from dwgs.splat.splats import Layers, Objects, Rendering, Splats, View


def render(
    splats: Splats,
    view: View,
    layers: Layers | None = None,
    objects: Objects | None = None,
    antialiased: bool = False,
    features: Tensor | None = None,
    threads: int = 2,
) -> Rendering:
    """The image of ``splats`` in ``view``; a gradient flows to every field of both, and to the objects' poses.

    See `project` for ``objects`` and ``antialiased``, `composite` for ``layers`` and ``features`` [N, F].
    """
    return composite(project(splats, view, objects, antialiased, threads), view, layers, features, threads)
