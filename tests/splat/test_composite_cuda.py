"""The GPU scheme, without a GPU: its source runs on the CPU as a witness, and it compiles for one."""

from dataclasses import replace

import pytest
import torch
import warp as wp

from dwgs.splat import Layers, View, project, render
from dwgs.splat.kernels import bin_cuda, composite_cuda, gather
from dwgs.splat.kernels import project as project_kernels
from dwgs.splat.ops.composite import bin


def test_both_schemes_agree(make_cloud, make_view, leaves, gradients, request):
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
    request.getfixturevalue("as_on_gpu")
    theirs, v_theirs = look()
    for name in ("rgb", "depth", "alpha", "features"):
        assert (getattr(ours, name) - getattr(theirs, name)).abs().max() < 2e-5
    for a, b in zip(v_ours, v_theirs, strict=True):
        assert (a - b).norm() < 1e-5 * b.norm()


def test_both_ways_to_bin_agree(make_cloud, make_view, request):
    view = View.batch([make_view(width=140, height=130, seed=seed) for seed in range(2)])
    splats = make_cloud(n=3000)
    splats.means[100:200] = splats.means[0]  # as deep as each other: the first comes first
    records = project(splats, view).records
    dealt = bin(records, view, None, 2)
    request.getfixturevalue("as_on_gpu")
    sorted_ = bin(records, view, None, 2)
    assert max((dealt.ranges[:, 1] - dealt.ranges[:, 0]).tolist()) > 256
    for name in ("ends", "gaussian_from_isect", "isect_from_sorted"):
        assert getattr(dealt, name).equal(getattr(sorted_, name))
    sizes, sorted_sizes = (ranges[:, 1] - ranges[:, 0] for ranges in (dealt.ranges, sorted_.ranges))
    assert sizes.equal(sorted_sizes)
    assert dealt.ranges[sizes > 0].equal(sorted_.ranges[sizes > 0])


@pytest.mark.parametrize("arch", [80, 90, 120])
@pytest.mark.parametrize("module", [project_kernels, bin_cuda, composite_cuda, gather])
def test_kernels_compile_for_a_gpu(module, arch, tmp_path):
    wp.compile_aot_module(module.__name__, arch=arch, module_dir=tmp_path, use_ptx=False)
    assert list(tmp_path.glob("*.cubin"))
