"""Two processes over gloo that share a network out, against one that holds all of it."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file

from generator.training.loop import Saved, Stepped, Trainer, Validated
from generator.training.preview import preview
from generator.wan.adapter import load_adapter
from generator.wan.weights import Backbone

sys.path.insert(0, str(Path(__file__).parent))
from shared_training import ALL, BF16, CONFIG

pytestmark = pytest.mark.slow
STATE = "checkpoints/00000004/state.safetensors"


@pytest.fixture(scope="module")
def shared(cache, backbone_folder, tmp_path_factory):
    """What two processes left."""
    out = tmp_path_factory.mktemp("shared")
    launch = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc_per_node", "2"]
    script = Path(__file__).with_name("shared_training.py")
    arguments = [str(script), str(cache.folder), str(backbone_folder), str(out)]
    here = str(Path(__file__).parents[3])
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": here}
    done = subprocess.run([*launch, *arguments], capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr[-3000:]
    return out


@pytest.fixture
def alone(cache, backbone_folder, tmp_path):
    """Trains by one process; gives the trainer and its events."""

    def run(config, folder=None):
        trainer = Trainer(cache, Backbone.open(backbone_folder), config, folder or tmp_path / "alone")
        return trainer, list(trainer.run())

    return run


def told(folder):
    return json.loads((folder / "told.json").read_text())


def losses(events, kind):
    return [event.loss for event in events if isinstance(event, kind)]


def assert_alike(folder, other, atol):
    ours, theirs = (load_file(each / STATE) for each in (folder, other))
    assert ours.keys() == theirs.keys()
    for name in ours:
        torch.testing.assert_close(
            ours[name], theirs[name], atol=atol, rtol=1e-4, msg=lambda text, n=name: f"{n} {text}"
        )


def test_losses_weights_moments_and_averages_are_those_of_one_process(shared, alone):
    trainer, events = alone(CONFIG)
    said = told(shared / "straight")
    assert said["losses"] == pytest.approx(losses(events, Stepped), rel=1e-5)
    assert said["held_out"] == pytest.approx(losses(events, Validated), rel=1e-5)  # in the middle of it, and at its end
    assert_alike(shared / "straight", trainer.folder, atol=2e-5)
    energy = [float(clip.painted.double().square().mean()) for clip in preview(trainer)]
    assert said["painted"] == pytest.approx(energy, rel=1e-4)


def test_each_process_holds_half_of_every_tensor(shared):
    held = told(shared / "straight")["held"]
    assert sum(part for part, _ in held.values()) == pytest.approx(sum(n for _, n in held.values()) / 2, rel=0.05)
    assert all(part < n for name, (part, n) in held.items() if not name.endswith("scale_shift_table"))


def test_processes_with_a_copy_each_learn_the_same(shared, alone):
    trainer, events = alone(CONFIG)
    assert told(shared / "copied")["losses"] == pytest.approx(losses(events, Stepped), rel=1e-5)
    assert_alike(shared / "copied", trainer.folder, atol=2e-5)


def test_two_halves_are_the_whole_bit_by_bit(shared):
    ours, theirs = ((shared / name / STATE).read_bytes() for name in ("straight", "halved"))
    assert ours == theirs


def test_a_checkpoint_of_two_goes_on_in_one(shared, alone, tmp_path):
    half = tmp_path / "half"
    shutil.copytree(shared / "straight", half)
    shutil.rmtree(half / "checkpoints" / "00000004")
    _, events = alone(CONFIG, half)
    assert [event.step for event in events if isinstance(event, Saved)] == [4]
    assert losses(events, Stepped) == pytest.approx(told(shared / "straight")["losses"][2:], rel=1e-5)
    assert_alike(half, shared / "straight", atol=2e-5)


@pytest.mark.filterwarnings("ignore:Mismatch dtype between input and weight")  # torch: no fused kernel for it
def test_16_bits_round_as_in_one_process_and_leave_the_weights_32(shared, alone):
    _, events = alone(BF16)
    assert told(shared / "bf16")["losses"] == pytest.approx(losses(events, Stepped), rel=1e-3)
    assert {t.dtype for t in load_file(shared / "bf16" / STATE).values()} == {torch.float32}


def test_a_backbone_that_learns_is_shared_out_and_exported_whole(shared, alone):
    trainer, events = alone(ALL)
    assert told(shared / "all")["losses"] == pytest.approx(losses(events, Stepped), rel=1e-5)
    opened = Backbone.open(shared / "all" / "export" / "trained-backbone")
    adapter = load_adapter(shared / "all" / "export" / "adapter", opened.load_transformer())
    with trainer.averaged():
        for ours, theirs in zip(adapter.parameters(), trainer.adapter.parameters(), strict=True):
            torch.testing.assert_close(ours, theirs, atol=2e-5, rtol=1e-4)
