"""Bad input gets one clear sentence and exit code 2, and leaves nothing half-written."""

import pytest

from dwgs.cli import main


@pytest.fixture
def refused(capsys, tmp_path):
    """Runs a command that must fail; gives the sentence."""

    def run(*arguments: str) -> str:
        with pytest.raises(SystemExit) as exit:
            main([*arguments, "-o", str(tmp_path / "out")])
        assert exit.value.code == 2
        message = capsys.readouterr().err.strip().splitlines()[-1]
        assert message.startswith("dwgs: ")
        assert not (tmp_path / "out").exists() or not list((tmp_path / "out").rglob("*"))
        return message

    return run


def test_a_full_disk(refused, monkeypatch):
    def write(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("dwgs.video.write_lossless", write)
    monkeypatch.setattr("generator.conditions.folder.write_lossless", write)
    assert "disk is full" in refused("condition", "street", "--vehicle", "street", *TOY)


TOY = ("--frames", "0-8", "--size", "96x64")


def test_a_missing_drive(refused, tmp_path):
    assert "nowhere" in refused("insert", str(tmp_path / "nowhere"), "--vehicle", "street", "--ahead", "9")


def test_a_missing_vehicle(refused):
    assert "no-such.glb" in refused("insert", "street", "--vehicle", "no-such.glb", "--ahead", "9", *TOY)


def test_a_track_that_is_not_there_lists_those_that_are(refused):
    assert "parked-00" in refused("insert", "street", "--vehicle", "nobody", "--ahead", "9", *TOY)


def test_nothing_says_where_the_vehicle_drives(refused):
    assert "--ahead" in refused("insert", "street", "--vehicle", "parked-00", *TOY)


def test_an_unknown_generator_names_those_that_work(refused):
    message = refused("insert", "street", "--vehicle", "street", "--backend", "wan-point", *TOY)
    assert "composite" in message


def test_a_backend_without_its_weights(refused):
    assert "--backbone DIR" in refused("insert", "street", "--vehicle", "street", "--backend", "wan", *TOY)


@pytest.mark.parametrize("backend", ["composite", "asset"])
def test_whole_frames_of_a_backend_that_knows_none(refused, backend):
    message = refused("insert", "street", "--vehicle", "street", "--backend", backend, "--whole-frame", *TOY)
    assert "leave --whole-frame out" in message


def test_a_trajectory_shorter_than_the_clip(refused, tmp_path):
    path = tmp_path / "short.csv"
    path.write_text("t,x,y,z,heading\n0,10,0,0.8,0\n0.3,12,0,0.8,0\n")
    assert "covers" in refused("insert", "street", "--vehicle", "street", "--trajectory", str(path), *TOY)


def test_a_vehicle_behind_the_camera_in_every_frame(refused):
    assert "behind" in refused("insert", "street", "--vehicle", "street", "--ahead", "-40", *TOY)


def test_a_schedule_of_both_steps_and_seconds(refused, tmp_path):
    given = ("--track", "parked-00", "--background", str(tmp_path), "--steps", "9", "--seconds", "9")
    assert "--seconds" in refused("distill", "street", *given, *TOY)


@pytest.mark.parametrize("frames", ["8-3", "all", "3", "-1-4"])
def test_frames_that_are_not_there(refused, frames):
    assert refused("insert", "street", "--vehicle", "street", "--frames", frames, "--size", "96x64")


@pytest.mark.parametrize("size", ["96", "8x8", "0x0", "wide"])
def test_sizes_that_are_none(refused, size):
    assert "--size" in refused("insert", "street", "--vehicle", "street", "--frames", "0-8", "--size", size)


def test_an_insertion_is_reconstructed_jointly_or_not_at_all(refused, tmp_path):
    assert "--joint" in refused("reconstruct", "street", "--insertion", str(tmp_path), *TOY)


def test_a_track_whose_id_is_no_folder(refused, tmp_path, monkeypatch):
    from dataclasses import replace

    from dwgs.cli.options import Clip

    recorded = Clip("street", frames="0-2", size="96x64").open()
    tracks = tuple(replace(track, id=f"../{track.id}") for track in recorded.tracks)
    monkeypatch.setattr(Clip, "open", lambda self: replace(recorded, tracks=tracks))
    assert "letters, digits" in refused("reconstruct", "street", "--joint", *TOY)
