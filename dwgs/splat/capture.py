"""A whole step as one CUDA graph: launched at once, with nothing of Python in it."""

from collections.abc import Callable

import torch
import warp as wp

from dwgs.splat.ops.stream import known

WARM_UP = 3
"""Steps before the capture: what is made once is made then."""


def capture(step: Callable[[], None]) -> Callable[[], None]:
    """Take ``step``, which it runs a few times first, into a graph; what is returned runs it again.

    What the step reads and writes has to stay in place, its images need a ``capacity``, and whatever shall change from
    run to run has to be a tensor that is filled anew.
    """
    stream = torch.cuda.Stream()
    stream.wait_stream(torch.cuda.current_stream())
    with torch.cuda.stream(stream):
        for _ in range(WARM_UP):
            step()
    torch.cuda.current_stream().wait_stream(stream)
    graph = torch.cuda.CUDAGraph()
    same = known(str(stream.device), stream.cuda_stream)
    with torch.cuda.graph(graph, stream=stream), wp.ScopedCapture(stream=same, external=True):
        step()

    def replay(_keep: Callable[[], None] = step) -> None:  # the graph works in the step's own memory
        graph.replay()

    return replay
