"""The GPU scheme, without a GPU: its source runs on the CPU as a witness, and it compiles for one."""

import pytest
import warp as wp

from dwgs.splat import Layers, render
from dwgs.splat.kernels import bin, composite_cuda, gather, project
from dwgs.splat.ops import composite


def test_both_schemes_agree(make_cloud, make_view, leaves, gradients, monkeypatch):
    splats, view = make_cloud(n=100), make_view(width=40, height=30)
    layers = Layers.between(render(make_cloud(n=30, seed=3), view), render(make_cloud(n=30, seed=4), view))
    tensors = leaves(splats, view)
    ours = render(splats, view, layers)
    v_ours = gradients(ours, tensors)
    monkeypatch.setitem(composite._SCHEMES, "cpu", composite_cuda)
    monkeypatch.setattr(composite_cuda, "SLOTS", composite_cuda.BLOCK)  # each lane is a warp of its own
    theirs = render(splats, view, layers)
    v_theirs = gradients(theirs, tensors)
    for name in ("rgb", "depth", "alpha"):
        assert (getattr(ours, name) - getattr(theirs, name)).abs().max() < 2e-5
    for a, b in zip(v_ours, v_theirs, strict=True):
        assert (a - b).norm() < 1e-5 * b.norm()


@pytest.mark.parametrize("module", [project, bin, composite_cuda, gather])
def test_kernels_compile_for_a_gpu(module, tmp_path):
    wp.compile_aot_module(module.__name__, arch=90, module_dir=tmp_path, use_ptx=False)
    assert list(tmp_path.glob("*.cubin"))
