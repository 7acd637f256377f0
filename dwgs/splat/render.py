"""The whole way: project, bin, composite."""

from torch import Tensor

from dwgs.splat.ops.composite import composite
from dwgs.splat.ops.project import project
from dwgs.splat.splats import Layers, Objects, Rendering, Splats, View


def render(
    splats: Splats,
    view: View,
    layers: Layers | None = None,
    *,
    objects: Objects | None = None,
    antialiased: bool = False,
    features: Tensor | None = None,
    capacity: int | None = None,
    threads: int = 2,
) -> Rendering:
    """The image of ``splats`` in ``view``; a gradient flows to every field of both, and to the objects' poses.

    See `project` for ``objects`` and ``antialiased``, `composite` for ``layers``, ``features`` [N, F] and
    ``capacity``.
    """
    projected = project(splats, view, objects=objects, antialiased=antialiased, threads=threads)
    return composite(projected, view, layers, features=features, capacity=capacity, threads=threads)
