"""What a rendering takes, measured on a process of its own."""

import json
import subprocess
import sys

import pytest

PER_GAUSSIAN, PER_INTERSECTION, PER_PIXEL = 72, 28, 40
"""Bytes of a forward pass beside its input: records of 64 and counts; tile lists; planes."""
PER_INTERSECTION_BACK, PER_GAUSSIAN_BACK = 50, 160
"""What a backward pass adds: slots of 40; gradients of records and of the input itself, here of SH degree 1."""
SLACK = 16 << 20
"""Allocators keep some."""

MEASURE = """
import json, resource, sys, torch
from dwgs.splat import Splats, View, render

def cloud(n):
    random = torch.Generator().manual_seed(0)
    depth = 5 + 45 * torch.rand(n, generator=random)
    place = torch.rand(n, 2, generator=random) - 0.5
    means = torch.cat([place * torch.tensor([1.2, 0.8]) * depth[:, None], depth[:, None]], 1)
    return Splats(means, torch.randn(n, 4, generator=random), (depth[:, None] / 400).expand(n, 3).contiguous(),
                  torch.full((n,), 0.5), torch.zeros(n, 4, 3))

view = View(torch.eye(4), (620.0, 620.0, 360.0, 240.0), 720, 480)
peak = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
def step(n, backward):
    splats = cloud(n)
    if backward:
        for name in Splats.__dataclass_fields__:
            getattr(splats, name).requires_grad_()
    before = peak()
    rendering = render(splats, view)
    if backward:
        rendering.rgb.sum().backward()
    return peak() - before, int(rendering.intersections)
step(100, True)  # kernels and libraries
if sys.argv[1] == "many":
    for _ in range(10):
        step(2000, True)
    before = peak()
    for _ in range(60):
        step(2000, True)
    print(peak() - before)
else:
    print(json.dumps(step(400_000, sys.argv[1] == "backward")))
"""


def measured(what: str):
    """What the program above prints."""
    run = subprocess.run([sys.executable, "-c", MEASURE, what], capture_output=True, text=True, check=True)
    return json.loads(run.stdout)


pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="ru_maxrss counts kilobytes on Linux only")


def test_steps_leave_nothing_behind():
    one_image = 5 * 720 * 480 * 4
    assert measured("many") < 3 * one_image


@pytest.mark.parametrize("direction", ["forward", "backward"])
def test_memory_grows_as_stated(direction):
    grown, intersections = measured(direction)
    assert intersections > 500_000
    stated = PER_GAUSSIAN * 400_000 + PER_INTERSECTION * intersections + PER_PIXEL * 720 * 480 + SLACK
    if direction == "backward":
        stated += PER_GAUSSIAN_BACK * 400_000 + PER_INTERSECTION_BACK * intersections
    assert grown < stated
