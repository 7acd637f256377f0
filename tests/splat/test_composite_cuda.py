"""The GPU scheme, without a GPU: its source runs on the CPU as a witness, and it compiles for one."""

from dataclasses import replace

import pytest
import torch
import warp as wp

from dwgs.splat import Layers, View, render
from dwgs.splat.kernels import bin, composite_cuda, gather, project
from dwgs.splat.ops import composite


def test_both_schemes_agree(make_cloud, make_view, leaves, gradients, monkeypatch):
    splats = make_cloud(n=100)
    view = View.batch([make_view(width=40, height=30, seed=seed) for seed in range(2)])
    layers = Layers.between(render(make_cloud(n=30, seed=3), view), render(make_cloud(n=30, seed=4), view))
    features = torch.randn(100, 3, generator=torch.Generator().manual_seed(5)).requires_grad_()
    tensors = [features, *leaves(splats, view)]

    def look():
        rendering = render(splats, view, layers, features=features)
        # the helper weighs rgb, depth and alpha: features take part as another two rows of colours
        wide = replace(rendering, rgb=torch.cat([rendering.rgb, rendering.features], 1))
        return rendering, gradients(wide, tensors)

    ours, v_ours = look()
    monkeypatch.setitem(composite._SCHEMES, "cpu", composite_cuda)
    monkeypatch.setattr(composite_cuda, "SLOTS", composite_cuda.BLOCK)  # each lane is a warp of its own
    theirs, v_theirs = look()
    for name in ("rgb", "depth", "alpha", "features"):
        assert (getattr(ours, name) - getattr(theirs, name)).abs().max() < 2e-5
    for a, b in zip(v_ours, v_theirs, strict=True):
        assert (a - b).norm() < 1e-5 * b.norm()


@pytest.mark.parametrize("arch", [80, 90, 120])
@pytest.mark.parametrize("module", [project, bin, composite_cuda, gather])
def test_kernels_compile_for_a_gpu(module, arch, tmp_path):
    wp.compile_aot_module(module.__name__, arch=arch, module_dir=tmp_path, use_ptx=False)
    assert list(tmp_path.glob("*.cubin"))
