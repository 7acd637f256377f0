"""The whole chain with the paper's generator at toy width, as a person runs it."""

import json

import numpy as np
import pytest

from dwgs.cli import main
from dwgs.datasets import folder as scene_folder
from dwgs.formats import asset_folder
from generator.wan.adapter import new_adapter
from generator.wan.tiny import tiny_transformer, write_tiny_backbone

TOY = ["--frames", "0-52", "--size", "96x64", "--draft", "--distill-steps", "20", "--sampling-steps", "2"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Holds a toy backbone, an adapter for it, and what `dwgs insert` left of 53 frames: two stages."""
    folder = tmp_path_factory.mktemp("wan")
    write_tiny_backbone(folder / "backbone")
    new_adapter(tiny_transformer()).save(folder / "adapter")
    main(["insert", "street", "--vehicle", "street", *TOY, *wan(folder), "-o", str(folder / "out")])
    return folder


def wan(folder):
    return ["--backend", "wan", "--backbone", str(folder / "backbone"), "--adapter", str(folder / "adapter")]


def test_the_generated_drive_keeps_the_recording_around_its_masks(folder):
    recorded, edited = (scene_folder.read(folder / "out" / name) for name in ("recorded", "edited"))
    changed = 0
    for before, after in zip(recorded.all_frames(), edited.all_frames(), strict=True):
        differs = (before.pixels != after.pixels).any(-1)
        assert not (differs & ~after.reactive_mask).any()
        changed += int(np.count_nonzero(differs))
    assert changed > 0


def test_the_vehicle_is_distilled_from_it(folder):
    assert len(asset_folder.read(folder / "out" / "asset").body) > 0
    assert (folder / "out" / "asset" / "gaussians.ply").stat().st_size > 0
    report = json.loads((folder / "out" / "report.json").read_text())
    assert report["background_unchanged"] is True
    assert report["settings"]["generator"]["backend"] == "wan"


@pytest.mark.parametrize(
    ("option", "said"),
    [
        ("--backbone", "there is no 'nowhere/transformer/config.json'"),
        ("--adapter", "there is no 'nowhere/config.json'"),
        ("--size", "takes images whose sides are multiples of 16"),
    ],
)
def test_what_cannot_work_is_said_before_anything_is_read(folder, tmp_path, capsys, option, said):
    out = folder / "out"
    command = ["generate", str(out / "recorded"), "--conditions", str(out / "conditions"), *wan(folder)]
    with pytest.raises(SystemExit) as exit:
        main([*command, option, "50x32" if option == "--size" else "nowhere", "-o", str(tmp_path / "never")])
    assert exit.value.code == 2
    assert said in capsys.readouterr().err.splitlines()[-1]
    assert not list(tmp_path.iterdir())


def test_no_parts_are_left_behind(folder):
    assert not list((folder / "out").glob(".*.parts"))


def test_a_killed_generation_keeps_its_clips(folder, monkeypatch, capsys):
    """On the folders that `dwgs insert` left, with another seed."""
    out = folder / "out"
    command = ["generate", str(out / "recorded"), "--conditions", str(out / "conditions"), *wan(folder)]
    command += ["--sampling-steps", "2", "--seed", "1", "-o", str(folder / "again")]
    from generator.wan.network import Network

    generate, done = Network.generate, []

    def dies(self, *arguments):
        if done:
            raise KeyboardInterrupt
        done.append(1)
        return generate(self, *arguments)

    monkeypatch.setattr(Network, "generate", dies)
    with pytest.raises(SystemExit) as exit:
        main(command)
    assert exit.value.code == 130
    assert len(list(folder.glob(".again.parts/*/*.avi"))) == 1
    assert not (folder / "again").exists()
    done.clear()

    def counts(self, *arguments):
        done.append(1)
        return generate(self, *arguments)

    monkeypatch.setattr(Network, "generate", counts)
    main(command)
    assert len(done) == 2  # the two segments: the anchors were kept
    assert scene_folder.read(folder / "again").frames["front"]
    assert not list(folder.glob(".again.parts"))
