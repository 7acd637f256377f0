"""The specification's own gradients, by finite differences in float64."""

from dataclasses import fields, replace

import torch

from dwgs.splat import Splats, reference


def test_gradients_of_the_reference_are_slopes(make_cloud, make_view):
    cloud, view = make_cloud(n=8), make_view(width=20, height=15)
    # far from the cut, the clamp and the stop, where an image may jump
    scales, opacities = 6 * cloud.scales, 0.3 + 0.4 * cloud.opacities
    wide = Splats(0.3 * cloud.means, cloud.quats, scales, opacities, 0.3 * cloud.sh)
    assert not reference.borderline(wide, view, margin=1e-5).any()
    inputs = [getattr(wide, f.name).double().requires_grad_() for f in fields(Splats)]
    inputs.append(view.viewmat.double().requires_grad_())

    def image(*tensors):
        rendering = reference.render(Splats(*tensors[:5]), replace(view, viewmat=tensors[5]))
        return torch.cat([rendering.rgb.flatten(), rendering.depth.flatten(), rendering.alpha.flatten()])

    assert torch.autograd.gradcheck(image, inputs, eps=1e-7, atol=1e-5, fast_mode=True)
