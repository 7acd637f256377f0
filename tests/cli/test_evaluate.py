"""dwgs evaluate: a tiny street, two systems, from the command to the table."""

import hashlib
import json
import warnings

import pytest
import torch

from dwgs.cli import main
from dwgs.cli.backend import BackendChoice
from dwgs.cli.cases import read_cases
from dwgs.cli.options import Clip
from dwgs.cli.systems import ASIS, RECIPES, SYSTEMS, System
from dwgs.reconstruct import ReconstructConfig
from dwgs.scene import InputError
from generator.wan.adapter import new_adapter
from generator.wan.tiny import tiny_transformer, write_tiny_backbone

OWN = ("streetcrafter", "wan", "wan-finetuned", "wan-pixels", "wan-autoregressive")
TOY = ("--frames", "0-8", "--size", "96x64", "--draft", "--distill-steps", "20")


class Stub(torch.nn.Module):
    def forward(self, images):
        return images.mean(dim=(2, 3))


class ClipStub(torch.nn.Module):
    def forward(self, clips):
        return clips.mean(dim=(2, 3, 4))


def write(module, path):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        torch.jit.script(module).save(str(path))
    return f"{path}:{hashlib.sha256(path.read_bytes()).hexdigest()}"


def evaluate(out, *more, systems=("ground-truth", "asset", "asset-D", "vace")):
    main(["evaluate", "street:3", *TOY, "--systems", *systems, *more, "-o", str(out)])
    return json.loads((out / "table.json").read_text())


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    """Where a street of few Gaussians is reconstructed in few steps."""
    quick = staticmethod(lambda seed=0: ReconstructConfig(steps=20, gaussians=4000, grown=0, seed=seed))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ReconstructConfig, "draft", quick)
        yield tmp_path_factory.mktemp("evaluation") / "out"


@pytest.fixture(scope="module")
def table(out):
    return evaluate(out)


def test_the_table_holds_every_system_with_what_needs_no_weights(table, out):
    systems = table["systems"]
    assert systems["ground-truth"]["oracle_psnr"]["value"] == "inf"
    assert systems["asset"]["kept"]["value"] == 100
    assert systems["asset-D"]["kept"]["value"] < 100
    assert 8 < systems["asset"]["oracle_psnr"]["value"] < 40
    assert 8 < systems["asset-D"]["distill_psnr"]["value"] < 60
    for name in ("table.md", "table.png", "sheet.png"):
        assert (out / name).stat().st_size > 0
    assert not list(out.rglob(".*"))


def test_what_needs_weights_is_unavailable_and_never_a_number(table):
    for key in ("fid", "fvd", "lpips"):
        assert table["systems"]["asset"][key] == {"value": None, "reason": f"--{key} FILE"}


def test_a_backend_that_cannot_work_is_a_row_with_its_reason(table):
    assert "vace" in table["absent"]["vace"]
    assert all(cell["value"] is None for cell in table["systems"]["vace"].values())


def test_a_second_run_keeps_every_stage_and_gives_the_same_table(table, out, capsys):
    assert evaluate(out)["systems"] == table["systems"]
    said = capsys.readouterr().err
    assert "unchanged, kept" in said
    assert "━" not in said  # no bar: nothing ran


def test_a_new_system_leaves_the_finished_ones_alone(table, out, capsys):
    before = (out / "street-3" / "asset" / "edited" / "run.json").stat().st_mtime_ns
    systems = evaluate(out, systems=("asset", "ground-truth-D"))["systems"]
    assert set(systems) == {"asset", "ground-truth-D"}
    assert (out / "street-3" / "asset" / "edited" / "run.json").stat().st_mtime_ns == before


def test_stub_networks_by_path_fill_their_columns(table, out, tmp_path):
    fid, fvd = write(Stub(), tmp_path / "fid.pt"), write(ClipStub(), tmp_path / "fvd.pt")
    systems = evaluate(out, "--fid", fid, "--fvd", fvd)["systems"]
    assert systems["asset"]["fid"]["value"] > 0
    assert systems["asset"]["fvd"] == {"value": None, "reason": "no sequence is long enough"}  # nine frames are no clip
    assert systems["asset"]["lpips"]["value"] is None
    assert systems["asset"]["oracle_psnr"] == table["systems"]["asset"]["oracle_psnr"]


def test_a_joint_reconstruction_is_made_where_it_is_asked_for(table, out):
    assert table["systems"]["asset"]["joint_psnr"] == {"value": None, "reason": "--joint"}
    systems = evaluate(out, "--joint", systems=("asset",))["systems"]
    assert 8 < systems["asset"]["joint_psnr"]["value"] < 50
    assert 0 < systems["asset"]["joint_ssim"]["value"] < 1


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    """A folder with a toy backbone, and for every system that has weights of its own what `dwgs train` leaves."""
    folder = tmp_path_factory.mktemp("weights")
    write_tiny_backbone(folder / "backbone")
    for name in OWN:
        new_adapter(tiny_transformer()).save(folder / name / "adapter")
        (folder / name / "run.json").write_text(json.dumps({"settings": {**ASIS, **RECIPES[name].taught}}))
    write_tiny_backbone(folder / "wan-finetuned" / "trained-backbone")
    return folder


def test_every_system_runs_on_toy_weights(out, weights, tmp_path):
    names = [name for name in SYSTEMS if not name.endswith("-D") or name == "streetcrafter-D"]
    given = ["--systems", *names, "--backbone", str(weights / "backbone"), "--trained"]
    for name in OWN:
        given += [name, str(weights / name)]
    small = ["--frames", "0-4", "--size", "48x32", "--draft", "--distill-steps", "2", "--sampling-steps", "1"]
    fid = write(Stub(), tmp_path / "fid.pt")
    main(["evaluate", "street:3", *small, *given, "--fid", fid, "-o", str(out.parent / "every")])
    document = json.loads((out.parent / "every" / "table.json").read_text())
    assert list(document["systems"]) == names
    assert document["absent"] == {}
    for name, cells in document["systems"].items():
        assert cells["fid"]["value"] > 0
        assert cells["lpips"] == {"value": None, "reason": "--lpips FILE"}
        whole = name in ("ground-truth", "streetcrafter", "streetcrafter-D")  # may change any pixel
        assert (cells["kept"]["value"] == 100) == (not whole)


def test_a_system_takes_the_weights_of_its_own_training(weights):
    given = BackendChoice(backbone=weights / "backbone")
    trained = {name: weights / name for name in OWN}
    full, pixels, own = (System.of(name, given, trained) for name in ("wan-finetuned", "wan-pixels-D", "wan"))
    assert full.choice.backbone == weights / "wan-finetuned" / "trained-backbone"
    assert (pixels.points, own.points) == ("pixels", "discs")
    assert pixels.choice.adapter == weights / "wan-pixels" / "adapter"
    assert System.of("wan-autoregressive", given, trained).choice.strategy == "autoregressive"
    assert System.of("streetcrafter", given, trained).choice.whole_frame


@pytest.mark.parametrize(
    ("name", "trained", "complaint"),
    [
        ("wan-pixels", {}, "give --trained wan-pixels DIR, from `dwgs train --points pixels`"),
        ("streetcrafter-D", {}, "from `dwgs train --strategy autoregressive --whole-frame`"),
        ("wan-pixels", {"wan-pixels": "wan"}, "was taught with points discs; give what `dwgs train --points pixels`"),
        ("wan", {"wan": "wan-finetuned"}, "was taught with trains all; give what `dwgs train` left"),
        ("wan-finetuned", {"wan-finetuned": "backbone"}, "is no finished training"),
        ("wan", {}, "give --adapter DIR"),
    ],
)
def test_a_system_without_its_weights_says_what_makes_them(weights, name, trained, complaint):
    folders = {key: weights / folder for key, folder in trained.items()}
    system = System.of(name, BackendChoice(backbone=weights / "backbone"), folders)
    assert system.choice is None
    assert complaint in system.obstacle


def test_a_system_that_fails_on_the_way_loses_no_other(out, weights):
    given = ["--systems", "asset", "vace", "--backbone", str(weights / "backbone")]
    odd = ["--frames", "0-4", "--size", "50x32", "--draft"]
    main(["evaluate", "street:3", *odd, *given, "-o", str(out.parent / "odd")])
    document = json.loads((out.parent / "odd" / "table.json").read_text())
    assert "street-3: 'vace' takes images whose sides are multiples of 16" in document["absent"]["vace"]
    assert document["systems"]["asset"]["kept"]["value"] == 100


def refusal(capsys, *arguments):
    with pytest.raises(SystemExit) as exit:
        main(["evaluate", *arguments])
    assert exit.value.code == 2
    return capsys.readouterr().err.strip().splitlines()[-1]


def test_a_wrong_hash_is_refused_before_anything_runs(capsys, tmp_path):
    path = tmp_path / "fid.pt"
    write(Stub(), path)
    said = refusal(capsys, "street:3", *TOY, "--fid", f"{path}:{'0' * 64}", "-o", str(tmp_path / "out"))
    assert "not loaded" in said
    assert not (tmp_path / "out").exists()


def test_an_unknown_system_names_those_there_are(capsys, tmp_path):
    said = refusal(capsys, "street:3", *TOY, "--systems", "magic", "-o", str(tmp_path / "out"))
    assert "composite-D" in said


@pytest.mark.parametrize("name", ["magic", "wan-D", "composite"])
def test_weights_for_a_system_that_takes_none_are_refused(capsys, tmp_path, name):
    said = refusal(capsys, "street:3", *TOY, "--trained", name, str(tmp_path), "-o", str(tmp_path / "out"))
    assert (
        f"--trained is for streetcrafter, wan, wan-finetuned, wan-pixels, wan-autoregressive, not for '{name}'" in said
    )


def test_a_drive_without_a_vehicle_is_refused_with_an_example(capsys, tmp_path):
    assert '"vehicle": "car.glb"' in refusal(capsys, str(tmp_path), "-o", str(tmp_path / "out"))


def cases(tmp_path, entries):
    path = tmp_path / "cases.json"
    path.write_text(entries if isinstance(entries, str) else json.dumps(entries))
    return read_cases([str(path)], Clip("", frames="0-9", size="96x64"))


def test_a_list_of_cases_says_what_drives_where(tmp_path):
    (tmp_path / "car.glb").touch()
    first, second = cases(
        tmp_path,
        [
            {"scene": "street:1", "vehicle": "street", "ahead": 12, "left": -3},
            {"scene": "street", "vehicle": "car.glb", "trajectory": "way.csv", "frames": "3-8", "camera": "front"},
        ],
    )
    assert (first.name, second.name) == ("cases-0", "cases-1")
    assert (first.clip.scene, first.clip.frames, first.placement.ahead, first.placement.left) == (
        "street:1",
        "0-9",
        12,
        -3,
    )
    assert first.knows_truth
    assert not second.knows_truth
    assert second.choice.vehicle == str(tmp_path / "car.glb")
    assert (second.clip.frames, second.clip.camera) == ("3-8", ("front",))


@pytest.mark.parametrize(
    ("entries", "complaint"),
    [
        ("nothing", "not JSON"),
        ({"scene": "street"}, "a list of objects"),
        ([{"scene": "street"}], "lacks"),
        ([{"scene": "street", "vehicle": "street", "speeed": 3}], "'speeed' is none"),
        ([{"scene": "street", "vehicle": "street", "ahead": "far"}], "are numbers"),
        ([], "at least one case"),
    ],
)
def test_a_list_of_cases_that_is_none_is_refused(tmp_path, entries, complaint):
    with pytest.raises(InputError, match=complaint):
        cases(tmp_path, entries)
