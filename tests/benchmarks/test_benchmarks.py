import json
import shutil
from dataclasses import fields
from typing import get_args

import pytest
import torch

from benchmarks import __main__ as command
from benchmarks.metric import Metric, write
from benchmarks.rivals import dense
from benchmarks.rivals.cpp import Cpp
from benchmarks.workloads.splat import SCENES, Ours, car
from dwgs.splat import Splats, View, composite, project, reference

needs_compiler = pytest.mark.skipif(not (shutil.which("c++") or shutil.which("g++")), reason="no C++ compiler")


@pytest.fixture
def small() -> Ours:
    """A car of few Gaussians; the image is not of whole tiles, and the loss does not look where it may jump."""
    splats, view = car(300)
    ours = Ours(splats, View(view.viewmat, (150.0, 160.0, 41.0, 29.0), 84, 60))
    ours.v_image[:, :60, :84] *= ~reference.borderline(ours.splats, ours.view)
    return ours


@needs_compiler
def test_rivals_draw_our_image_and_find_our_gradients(small):
    projected = project(small.splats, small.view)
    records = projected.records.detach().requires_grad_()
    rendering = composite(type(projected)(records), small.view)
    ours = torch.cat([rendering.rgb.movedim(-1, 0), rendering.depth[None], rendering.alpha[None]])
    v_inside = small.v_image[:, :60, :84]
    (v_ours,) = torch.autograd.grad(ours, records, v_inside)

    binned = small.bin(records.detach())
    cpp = Cpp(records, binned, small.view)
    cpp.composite()
    cpp.composite_adjoint(small.v_image)
    by_torch = dense.composite(records, binned, small.view)
    (v_by_torch,) = torch.autograd.grad(by_torch, records, small.v_image)

    judged = v_inside != 0
    for image, v_records in ((cpp.image, cpp.v_records), (by_torch, v_by_torch)):
        torch.testing.assert_close(image[:, :60, :84][judged], ours[judged], rtol=1e-5, atol=1e-5)
        error = (v_records - v_ours).norm(dim=0) / v_ours.norm(dim=0).clamp_min(1e-10)
        assert error.max() < 1e-5
    assert ours[4].max() > 0.9


@needs_compiler
def test_the_cpp_rival_counts_lanes_of_whole_blocks(small):
    records = project(small.splats, small.view).records.detach()
    count = Cpp(records, small.bin(records), small.view).count()
    assert count.lanes % 16 == 0
    assert 0 < count.live <= count.lanes


def test_scenes_are_the_same_every_time():
    (first, _), (second, _) = SCENES["car5k"](), SCENES["car5k"]()
    assert all(torch.equal(getattr(first, f.name), getattr(second, f.name)) for f in fields(Splats))


def test_the_command_knows_every_scene():
    assert get_args(command.SplatScene) == tuple(SCENES)


def test_options_of_one_workload_are_not_options_of_another(monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["benchmarks", "run", "oracle", "--repeats", "3"])
    with pytest.raises(SystemExit):
        command.main()
    assert "--repeats" in capsys.readouterr().err


def test_metrics_are_written_with_their_spread(tmp_path):
    write([Metric("a.b", 2.5, "ms", 0.5), Metric("a.c", 3.0, "")], tmp_path / "m.json")
    written = json.loads((tmp_path / "m.json").read_text())
    assert written["metrics"][0] == {"key": "a.b", "value": 2.5, "unit": "ms", "spread": 0.5}
    assert written["metrics"][1]["spread"] is None
    assert "cpu" in written["machine"]
