"""The whole chain at toy size, as a person runs it."""

import json
import re

import pytest

from dwgs.cli import main
from dwgs.datasets import folder as scene_folder
from dwgs.formats import asset_folder, background_folder

TOY = ["--frames", "0-16", "--size", "144x96", "--draft", "--distill-steps", "40"]


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    """What `dwgs insert` leaves of seventeen small frames of the street."""
    folder = tmp_path_factory.mktemp("chain") / "out"
    main(["insert", "street", "--vehicle", "street", *TOY, "-o", str(folder)])
    return folder


def test_insert_leaves_everything_it_promises(out):
    for name in ("background", "conditions", "edited", "asset"):
        assert (out / name).is_dir()
    for name in ("before.mp4", "after.mp4", "orbit.mp4", "report.html", "report.json"):
        assert (out / name).stat().st_size > 0
    assert not [p for p in out.rglob(".*") if p.name != ".films.json"]


def test_the_report_holds_what_programs_ask_for(out):
    report = json.loads((out / "report.json").read_text())
    assert report["background_unchanged"] is True
    assert report["distill"]["psnr_roi_heldout"] > 15
    assert 0 < report["distill"]["ssim_roi_heldout"] <= 1
    assert report["distill"]["gaussians"] > 0
    assert report["reconstruct"]["psnr_heldout"] > 12
    for stage in report["stages"].values():
        assert stage["seconds"] >= 0
        assert stage["peak_memory_mib"] > 0


def test_the_report_is_self_contained(out):
    page = (out / "report.html").read_text()
    markup, films = re.subn(r"data:video/mp4;base64,[A-Za-z0-9+/=]+", "", page)
    markup = re.sub(r"data:image/jpeg;base64,[A-Za-z0-9+/=]+", "", markup)
    assert films == 3
    assert len(markup) < 100_000
    assert "http" not in markup


def test_the_edited_drive_differs_from_the_recording_only_inside_its_masks(out):
    recorded, edited = scene_folder.read(out / "recorded"), scene_folder.read(out / "edited")
    changed = 0
    for before, after in zip(recorded.all_frames(), edited.all_frames(), strict=True):
        differs = (before.pixels != after.pixels).any(-1)
        assert not (differs & ~after.reactive_mask).any()
        changed += differs.sum()
    assert changed > 0


def test_a_second_run_keeps_every_stage(out, capsys):
    before = background_folder.fingerprint(out / "background")
    main(["insert", "street", "--vehicle", "street", *TOY, "-o", str(out)])
    report = json.loads((out / "report.json").read_text())
    assert all(stage["skipped"] for stage in report["stages"].values())
    assert background_folder.fingerprint(out / "background") == before


def test_another_seed_runs_only_what_depends_on_it(out):
    main(["insert", "street", "--vehicle", "street", *TOY, "--distill-steps", "41", "-o", str(out)])
    report = json.loads((out / "report.json").read_text())
    fresh = {name for name, stage in report["stages"].items() if not stage["skipped"]}
    assert fresh == {"distill", "films"}


def test_the_street_renders_with_the_vehicle_moved_and_removed(out):
    for name, extra in (("moved", ["--asset", str(out / "asset"), "--move", "3", "0", "0"]), ("removed", [])):
        film = out / f"{name}.avi"
        main(["render", str(out / "recorded"), "--background", str(out / "background"), *extra, "-o", str(film)])
        assert film.stat().st_size > 0


def test_the_asset_says_where_it_comes_from(out):
    asset = asset_folder.read(out / "asset")
    assert asset.provenance
    assert asset.quality["psnr_roi_heldout"] > 15


def test_the_edited_drive_is_reconstructed_whole_renders_with_its_traffic_and_is_distilled_among_it(out):
    joint = out / "joint"
    insertion = out / "conditions" / "insertion"
    main(["reconstruct", str(out / "edited"), "--joint", "--draft", "--insertion", str(insertion), "-o", str(joint)])
    report = json.loads((joint / "report.json").read_text())
    assert report["psnr_train"] > 15
    assert "inserted" in [actor["id"] for actor in report["actors"]]
    assert (joint / "worst.png").stat().st_size > 0
    film = out / "whole.mkv"
    actors = [str(folder) for folder in sorted((joint / "traffic").iterdir())]
    assert len(actors) == len(report["actors"])
    main(["render", str(out / "edited"), "--background", str(joint), "--asset", *actors, "-o", str(film)])
    assert film.stat().st_size > 0
    given = ["--background", str(joint), "--traffic", *actors, "--insertion", str(insertion), "--steps", "20"]
    main(["distill", str(out / "edited"), *given, "-o", str(out / "among")])
    assert asset_folder.read(out / "among").quality["psnr_roi_heldout"] > 15
