"""Outputs appear whole or not at all."""

import pytest

from dwgs.files import new_file, new_folder


def test_a_file_takes_its_place_when_it_is_whole(tmp_path):
    with new_file(tmp_path / "a" / "x.txt") as draft:
        draft.write_text("new")
        assert not (tmp_path / "a" / "x.txt").exists()
    assert (tmp_path / "a" / "x.txt").read_text() == "new"


@pytest.mark.parametrize("new", [new_file, new_folder])
def test_a_failure_leaves_what_was_there_and_nothing_else(tmp_path, new):
    path = tmp_path / "x"
    if new is new_file:
        path.write_text("old")
    else:
        path.mkdir()

    def fail_half_way():
        with new(path) as draft:
            (draft if new is new_file else draft / "part").write_text("half")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail_half_way()
    assert [p.name for p in tmp_path.iterdir()] == ["x"]
    assert path.read_text() == "old" if new is new_file else not list(path.iterdir())


def test_a_folder_replaces_the_former_one_whole(tmp_path):
    for name in ("first", "second"):
        with new_folder(tmp_path / "x") as draft:
            (draft / name).write_text(name)
    assert [p.name for p in (tmp_path / "x").iterdir()] == ["second"]
    assert [p.name for p in tmp_path.iterdir()] == ["x"]
