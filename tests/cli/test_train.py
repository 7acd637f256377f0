"""`dwgs train` on the embedded street, at toy size, as a person runs it."""

import json
import os
import subprocess
import sys

import pytest
import torch
from safetensors.torch import load_file

from dwgs.cli import main
from dwgs.cli.systems import ASIS
from dwgs.datasets import folder as scene_folder
from generator.wan.settings import WanSettings
from generator.wan.wan import WanGenerator

WEIGHTS = "diffusion_pytorch_model.safetensors"
TOY = ["--preset", "tiny", "--size", "48x32", "--batch", "2"]


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """A short recorded street with only eight of its vehicles: seven teach, one is held out."""
    from dataclasses import replace

    from dwgs.street import build_street

    scene = build_street(frames=13, width=48, height=32).scene()
    seen = ("moving-00", "moving-01", *(f"parked-{i:02d}" for i in range(4, 10)))
    kept = tuple(track for track in scene.tracks if track.id in seen)
    folder = tmp_path_factory.mktemp("drive") / "street"
    scene_folder.write(replace(scene, tracks=kept), folder)
    return folder


@pytest.fixture(scope="module")
def out(drive, tmp_path_factory):
    folder = tmp_path_factory.mktemp("train") / "out"
    main(["train", str(drive), *TOY, "--steps", "3", "-o", str(folder)])
    return folder


def test_training_leaves_an_adapter_that_generates(out):
    generator = WanGenerator(WanSettings(out / "backbone", out / "adapter"))
    assert generator.name == "wan"
    events = [json.loads(line) for line in (out / "log.jsonl").read_text().splitlines()]
    assert [e["step"] for e in events if e["event"] == "stepped"] == [1, 2, 3]
    assert [path.name for path in (out / "validation").iterdir()] == ["00000003.mp4"]


def test_it_leaves_what_it_was_told_for_whoever_compares(out):
    settings = json.loads((out / "run.json").read_text())["settings"]
    assert {key: settings[key] for key in ASIS} == ASIS


def test_more_steps_go_on_from_the_last_checkpoint(out, drive, capsys):
    main(["train", str(drive), *TOY, "--steps", "5", "-o", str(out)])
    said = capsys.readouterr().err
    assert "going on after step 3" in said
    assert "encode       unchanged, kept" in said
    assert [path.name for path in sorted((out / "checkpoints").iterdir())] == ["00000003", "00000005"]


@pytest.fixture(scope="module")
def launch(drive, tmp_path_factory):
    """Trains into a folder of that name with so many processes, as a person launches them."""
    root = tmp_path_factory.mktemp("launched")

    def run(name, processes, *options, steps=3):
        launcher = ["-m", "torch.distributed.run", "--standalone", "--nproc_per_node", str(processes)]
        command = ["-m", "dwgs", "train", str(drive), *TOY, "--steps", str(steps), *options, "-o", str(root / name)]
        whole = [sys.executable, *(launcher if processes > 1 else []), *command]
        done = subprocess.run(
            whole, check=True, capture_output=True, text=True, env={**os.environ, "OMP_NUM_THREADS": "1"}
        )
        (root / name / "said.txt").write_text(done.stderr)
        return root / name

    return run


@pytest.fixture(scope="module")
def alone(launch):
    """Three steps by one process."""
    return launch("one", 1)


def losses(folder):
    events = [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]
    return [event["loss"] for event in events if event["event"] == "stepped"]


def assert_alike(folder, other, atol=1e-5):
    ours, theirs = (load_file(each / "adapter" / WEIGHTS) for each in (folder, other))
    assert all(torch.allclose(ours[name], theirs[name], atol=atol) for name in ours | theirs)


def test_two_processes_learn_what_one_does(launch, alone):
    two = launch("two", 2)
    assert len(losses(alone)) == 3
    assert losses(two) == pytest.approx(losses(alone), rel=1e-5)
    assert_alike(two, alone)


def test_two_processes_that_share_the_network_out_learn_what_one_does(launch, alone):
    shared = launch("shared", 2, "--shard")
    assert losses(shared) == pytest.approx(losses(alone), rel=1e-5)
    assert_alike(shared, alone)
    said = (shared / "said.txt").read_text()
    assert said.count("each of 2 processes takes about") == said.count("next: dwgs insert") == 1


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nowhere", *TOY], "nowhere"),
        (["street", "--preset", "paper"], "give --backbone DIR"),
        (["street", *TOY, "--shard"], "shared out among several processes, there is one"),
        (["street", "--backbone", "no-such-folder"], "there is no 'no-such-folder/transformer/config.json'"),
    ],
)
def test_what_cannot_be_trained_is_said_in_one_sentence(arguments, said, tmp_path, capsys):
    with pytest.raises(SystemExit) as exit:
        main(["train", *arguments, "-o", str(tmp_path / "out")])
    assert exit.value.code == 2
    assert said in capsys.readouterr().err


def test_the_launchers_own_sharding_is_refused(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("ACCELERATE_USE_FSDP", "true")
    with pytest.raises(SystemExit):
        main(["train", "street", *TOY, "-o", str(tmp_path / "out")])
    assert "launch without --use_fsdp, and add --shard" in capsys.readouterr().err
