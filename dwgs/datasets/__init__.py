"""A recorded drive on disk to a `Scene`: one file per source. Foreign conventions end here."""

from pathlib import Path

from dwgs.datasets.resize import resize_scene as resize_scene
from dwgs.scene.errors import InputError
from dwgs.scene.scene import Scene


def open_scene(path: Path) -> Scene:
    """The scene at ``path``, whatever source it comes from: told apart by the files that are there.

    Raises `InputError` saying what was looked for where no source fits.
    """
    from dwgs.datasets import folder, pandaset  # the video library is not needed to say --help

    path = Path(path)
    if not path.is_dir():
        raise InputError(f"there is no folder '{path}'; give the folder of a recorded drive")
    marks = {folder.SCENE_FILE: folder.read, "lidar/poses.json": pandaset.read}
    for mark, read in marks.items():
        if (path / mark).is_file():
            return read(path)
    within = [child for child in sorted(path.iterdir()) if any((child / mark).is_file() for mark in marks)]
    hint = f"; did you mean '{within[0]}'?" if within else ""
    raise InputError(
        f"'{path}' is no drive that can be read: it has neither scene.json (a folder that a stage wrote) "
        f"nor lidar/poses.json (a PandaSet sequence){hint}"
    )
