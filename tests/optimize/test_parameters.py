"""Trainable Gaussians: activated outside, unbounded inside, growing and shrinking under one optimiser."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch

from dwgs.optimize import PoseParameters, Rates, SplatParameters, Together
from dwgs.scene import Gaussians
from dwgs.splat import Splats

RATES = Rates(means=0.01, quats=0.01, scales=0.01, opacities=0.05, sh_dc=0.02, sh_rest=0.01)


def cloud(count: int, seed: int = 0) -> Gaussians:
    rng = np.random.default_rng(seed)
    fields = (
        rng.normal(size=(count, 3)),
        np.tile([1.0, 0, 0, 0], (count, 1)),
        rng.uniform(0.01, 0.1, (count, 3)),
        rng.uniform(0.1, 0.9, count),
        rng.normal(size=(count, 4, 3)),
    )
    return Gaussians(*(f.astype(np.float32) for f in fields))


def pull(parameters: SplatParameters) -> float:
    """One step towards the origin."""
    loss = parameters.splats().means.square().sum()
    loss.backward()
    parameters.step()
    return loss.item()


def test_what_goes_in_comes_out():
    gaussians = cloud(20)
    back = SplatParameters(gaussians, RATES).to_gaussians()
    for name in ("means", "quats", "scales", "opacities", "sh"):
        np.testing.assert_allclose(getattr(back, name), getattr(gaussians, name), rtol=2e-6, atol=1e-6)


def test_steps_go_downhill():
    parameters = SplatParameters(cloud(20), RATES)
    losses = [pull(parameters) for _ in range(20)]
    assert losses[-1] < losses[0]


@pytest.mark.parametrize(("stillness", "amplified"), [(0.0, ()), (0.3, ()), (0.3, ("means", "scales"))])
def test_steps_are_those_of_adam_on_logs_and_logits_by_amplified_gradients(stillness, amplified):
    gaussians = cloud(9000)
    parameters = SplatParameters(gaussians, replace(RATES, stillness=stillness, amplified=amplified))
    raw = {
        "means": torch.tensor(gaussians.means),
        "quats": torch.tensor(gaussians.quats),
        "scales": torch.tensor(gaussians.scales).log(),
        "opacities": torch.tensor(gaussians.opacities).logit(),
        "sh_dc": torch.tensor(gaussians.sh[:, :1]),
        "sh_rest": torch.tensor(gaussians.sh[:, 1:]),
    }
    groups = [{"params": [values.requires_grad_()], "lr": getattr(RATES, name)} for name, values in raw.items()]
    adam = torch.optim.Adam(groups, betas=RATES.betas, eps=1e-15)
    trends = {name: torch.zeros_like(raw[name]) for name in amplified}
    weights = [torch.randn(9000, 26, generator=torch.Generator().manual_seed(k)) for k in range(4)]

    def loss(means, quats, scales, opacities, sh, weight):
        flat = torch.cat([means, quats, scales, opacities[:, None], sh.flatten(1)], 1)
        return (flat.pow(2) * weight[:, : flat.shape[1]]).sum()

    for weight in weights:
        splats = parameters.splats()
        loss(*(getattr(splats, name) for name in Splats.__dataclass_fields__), weight).backward()
        parameters.step()
        sh = torch.cat([raw["sh_dc"], raw["sh_rest"]], 1)
        loss(raw["means"], raw["quats"], raw["scales"].exp(), raw["opacities"].sigmoid(), sh, weight).backward()
        for name in amplified:
            gradient = raw[name].grad
            gradient += 1.5 * trends[name].lerp_(gradient, 0.01)
        for group in adam.param_groups:
            known = adam.state.get(group["params"][0])
            group["eps"] = max(1e-15, stillness * known["exp_avg_sq"].mean().sqrt().item()) if known else 1e-15
        adam.step()
        adam.zero_grad()
    ours = parameters.splats()
    assert torch.allclose(ours.means, raw["means"], atol=2e-6)
    assert torch.allclose(ours.quats, raw["quats"], atol=2e-6)
    assert torch.allclose(ours.scales, raw["scales"].exp(), rtol=2e-5)
    assert torch.allclose(ours.opacities, raw["opacities"].sigmoid(), atol=2e-5)
    assert torch.allclose(ours.sh, torch.cat([raw["sh_dc"], raw["sh_rest"]], 1), atol=2e-5)


def test_what_leaves_its_bounds_is_held_and_finds_back():
    gaussians = cloud(20)
    bounds = np.array([[-0.5] * 3, [0.5] * 3])
    parameters = SplatParameters(gaussians, RATES, bounds=bounds, max_scales=(0.05,) * 3)
    assert (parameters.splats().means.abs() <= 0.5).all()
    assert (parameters.splats().scales <= 0.05 * (1 + 1e-6)).all()
    outside = torch.tensor(np.abs(gaussians.means) > 0.52)
    for _ in range(10):
        (-parameters.splats().means.abs().sum() - parameters.splats().scales.sum()).backward()  # pushed further out
        parameters.step()
    assert (parameters.splats().means.abs() <= 0.5).all()
    assert (parameters.splats().scales <= 0.05 * (1 + 1e-6)).all()
    for _ in range(20):
        (parameters.splats().means.abs().sum() + parameters.splats().scales.sum()).backward()
        parameters.step()
    assert (parameters.splats().means[outside].abs() < 0.5).all()  # without first going back all that way
    assert (parameters.splats().scales < 0.05).all()


def test_some_are_confined_and_the_others_left_alone():
    gaussians = cloud(20)
    parameters = SplatParameters(gaussians, RATES)
    bounds = torch.tensor([[-0.1, -0.2, -0.3], [0.1, 0.2, 0.3]])
    for _ in range(2):
        parameters.confine(slice(5, 12), bounds, 0.05)
        confined = parameters.to_gaussians()
        assert (np.abs(confined.means[5:12]) <= [0.1 + 1e-6, 0.2 + 1e-6, 0.3 + 1e-6]).all()
        assert (confined.scales[5:12] <= 0.05 * (1 + 1e-6)).all()
        others = np.r_[:5, 12:20]
        np.testing.assert_array_equal(confined.means[others], parameters.splats().means.detach().numpy()[others])
        assert (np.abs(confined.means[others]) > 0.3).any()
        pull(parameters)  # from where they are now


def test_a_mean_steps_as_far_as_its_scale_says():
    scale = torch.tensor([1.0] * 10 + [100.0] * 10)
    gaussians = cloud(20)
    parameters = SplatParameters(gaussians, RATES, scale)
    pull(parameters)
    moved = np.abs(parameters.to_gaussians().means - gaussians.means).mean(1)
    assert moved[10:].mean() == pytest.approx(100 * moved[:10].mean(), rel=0.01)


def test_growing_keeps_what_the_optimiser_knows_of_the_others():
    alone, grown = SplatParameters(cloud(20), RATES), SplatParameters(cloud(20), RATES)
    for _ in range(3):
        pull(alone), pull(grown)
    grown.append(cloud(5, seed=1))
    pull(alone), pull(grown)
    assert len(grown) == 25
    np.testing.assert_allclose(grown.to_gaussians().means[:20], alone.to_gaussians().means, atol=1e-6)


def test_shrinking_keeps_what_the_mask_says():
    parameters = SplatParameters(cloud(20), RATES)
    pull(parameters)
    before = parameters.to_gaussians()
    mask = torch.arange(20) % 2 == 0
    parameters.keep(mask)
    np.testing.assert_array_equal(parameters.to_gaussians().means, before.means[mask.numpy()])
    pull(parameters)


def test_pose_corrections_begin_as_nothing_and_stay_rigid():
    poses = PoseParameters(3, 1e-2, 1e-2)
    torch.testing.assert_close(poses.matrix(1), torch.eye(4))
    for _ in range(5):
        (poses.matrix(1)[:3, 3].sum() + poses.matrix(1)[0, 1]).backward()
        poses.step()
    rotation = poses.matrix(1)[:3, :3]
    torch.testing.assert_close(rotation @ rotation.T, torch.eye(3))
    torch.testing.assert_close(poses.matrix(0), torch.eye(4))
    torch.testing.assert_close(poses.matrices([1, 0, 1]), torch.stack([poses.matrix(i) for i in (1, 0, 1)]))


def test_the_first_step_of_a_process_may_take_two_threads():
    # threads that load a kernel at the same time lose it
    program = """
import numpy as np
from dwgs.optimize import Rates, SplatParameters
from dwgs.scene import Gaussians
n = 200_000
cloud = Gaussians(*(np.ones(shape, np.float32) for shape in ((n, 3), (n, 4), (n, 3), n, (n, 4, 3))))
parameters = SplatParameters(cloud, Rates(means=1, quats=1, scales=1, opacities=1, sh_dc=1, sh_rest=1))
parameters.splats().sh.sum().backward()
parameters.step()
assert (parameters.to_gaussians().sh[:, 0] < 0.5).all()
"""
    subprocess.run([sys.executable, "-c", program], check=True, timeout=120)


def test_together_parts_step_as_alone():
    rates = RATES, replace(RATES, means=0.1, sh_rest=0.0)
    alone = [SplatParameters(cloud(n, seed=n), rate) for n, rate in zip((20, 30), rates, strict=True)]
    parts = [SplatParameters(cloud(n, seed=n), rate) for n, rate in zip((20, 30), rates, strict=True)]
    together = Together(parts)
    random = torch.Generator().manual_seed(0)
    for _ in range(3):
        leaves = [getattr(together.splats(), name) for name in Splats.__dataclass_fields__]
        weights = [torch.randn(leaf.shape, generator=random) for leaf in leaves]
        torch.stack([(leaf * weight).sum() for leaf, weight in zip(leaves, weights, strict=True)]).sum().backward()
        together.step(0.5)
        for part, span in zip(alone, (slice(0, 20), slice(20, 50)), strict=True):
            leaves = [getattr(part.splats(), name) for name in Splats.__dataclass_fields__]
            losses = [(leaf * weight[span]).sum() for leaf, weight in zip(leaves, weights, strict=True)]
            torch.stack(losses).sum().backward()
            part.step(0.5)
    for ours, theirs in zip(parts, alone, strict=True):
        assert ours.flat().equal(theirs.flat())
        np.testing.assert_array_equal(ours.to_gaussians().scales, theirs.to_gaussians().scales)
    flat = parts[1].flat()
    together.splats().means.sum().backward()
    together.step(1.0)
    parts[1].load_flat(flat)
    np.testing.assert_array_equal(parts[1].to_gaussians().means, alone[1].to_gaussians().means)
