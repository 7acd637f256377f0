"""Trained Gaussians that other programs wrote."""

from pathlib import Path

import numpy as np
import pytest

from dwgs.formats import ply
from dwgs.scene import InputError

SPLATS = Path(__file__).parents[2].parent / "shared" / "data" / "splats"

pytestmark = pytest.mark.skipif(not SPLATS.is_dir(), reason=f"no real splats at {SPLATS}")


def test_a_trained_scene_is_read_and_written_back_to_the_same_numbers(tmp_path):
    path = SPLATS / "train-1000.ply"
    cloud = ply.read(path)
    assert len(cloud) == 1000
    assert cloud.sh_degree == 3
    ply.write(cloud, tmp_path / "a.ply")
    theirs, ours = (p.read_bytes().split(b"end_header\n", 1)[1] for p in (path, tmp_path / "a.ply"))
    theirs, ours = (np.frombuffer(body, "<f4").reshape(1000, 62) for body in (theirs, ours))
    kept = np.r_[0:3, 6:54]
    np.testing.assert_array_equal(ours[:, kept], theirs[:, kept])
    np.testing.assert_allclose(ours[:, 54:58], theirs[:, 54:58], atol=3e-6)
    lengths = np.linalg.norm(theirs[:, 58:], axis=1, keepdims=True)
    np.testing.assert_allclose(ours[:, 58:], theirs[:, 58:] / lengths, atol=1e-6)


def test_a_packed_file_is_refused_with_the_remedy():
    with pytest.raises(InputError, match="packed ones; convert"):
        ply.read(SPLATS / "guitar.compressed.ply")
