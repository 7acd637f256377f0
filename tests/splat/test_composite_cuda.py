"""The GPU scheme, without a GPU: its source runs on the CPU as a witness, and it compiles for one."""

from dataclasses import fields, replace

import pytest
import torch
import warp as wp

from dwgs.splat import Splats, render
from dwgs.splat.kernels import bin, composite_cuda, gather, project
from dwgs.splat.ops import composite


@pytest.fixture
def render_in_cuda_scheme(monkeypatch):
    """Render on the CPU as a GPU would, each lane being a warp of its own."""

    def render_so(*arguments):
        with monkeypatch.context() as patch:
            patch.setitem(composite._SCHEMES, "cpu", composite_cuda)
            patch.setattr(composite_cuda, "SLOTS", composite_cuda.BLOCK)
            rendering = render(*arguments)
            outputs = (rendering.rgb, rendering.depth, rendering.alpha)
            gradients = torch.autograd.grad(
                outputs, tensors(*arguments[:2]), [torch.ones_like(o) for o in outputs]
            )
        return rendering, gradients

    return render_so


def tensors(splats, view):
    return [*(getattr(splats, f.name) for f in fields(Splats)), view.viewmat]


def test_both_schemes_agree(make_cloud, make_view, render_in_cuda_scheme):
    splats, view = make_cloud(n=100), make_view(width=40, height=30)
    view = replace(view, viewmat=view.viewmat.requires_grad_())
    splats = Splats(*(getattr(splats, f.name).requires_grad_() for f in fields(Splats)))
    theirs, v_theirs = render_in_cuda_scheme(splats, view)
    ours = render(splats, view)
    outputs = (ours.rgb, ours.depth, ours.alpha)
    v_ours = torch.autograd.grad(outputs, tensors(splats, view), [torch.ones_like(o) for o in outputs])
    for a, b in zip(outputs, (theirs.rgb, theirs.depth, theirs.alpha), strict=True):
        assert (a - b).abs().max() < 2e-5
    for a, b in zip(v_ours, v_theirs, strict=True):
        assert (a - b).norm() < 1e-5 * b.norm()


@pytest.mark.parametrize("module", [project, bin, composite_cuda, gather])
def test_kernels_compile_for_a_gpu(module, tmp_path):
    wp.compile_aot_module(module.__name__, arch=90, module_dir=tmp_path, use_ptx=False)
    assert list(tmp_path.glob("*.cubin"))
