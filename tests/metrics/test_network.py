"""Networks from files."""

import hashlib

import numpy as np
import pytest
import torch
from stub_networks import ClipStub, ImageStub, PairStub, write

from dwgs.metrics.network import CLIP_FRAMES, CLIP_STRIDE, Network, NetworkFile
from dwgs.scene import InputError


@pytest.fixture
def video():
    return np.random.default_rng(0).integers(0, 256, (37, 12, 16, 3), np.uint8)


def load(module, tmp_path):
    return Network(NetworkFile.parse(write(module, tmp_path / "network.pt")))


def test_image_features_are_what_the_network_says_of_every_frame(tmp_path, video):
    features = load(ImageStub(), tmp_path).image_features(iter(video))
    expected = np.concatenate([video.mean((1, 2)), video[:, 0, 0]], 1)
    np.testing.assert_allclose(features, expected, rtol=1e-5)


def test_clips_overlap_by_half_and_published_switches_are_set(tmp_path, video):
    features = load(ClipStub(), tmp_path).clip_features(iter(video))
    starts = range(0, len(video) - CLIP_FRAMES + 1, CLIP_STRIDE)
    expected = [[video[s].mean(), video[s + CLIP_FRAMES - 1].mean()] for s in starts]
    np.testing.assert_allclose(features, expected, rtol=1e-5)


def test_a_video_shorter_than_a_clip_has_no_clip_features(tmp_path, video):
    assert load(ClipStub(), tmp_path).clip_features(iter(video[: CLIP_FRAMES - 1])).shape[0] == 0


def test_distances_are_of_pairs_between_minus_one_and_one(tmp_path, video):
    network = load(PairStub(), tmp_path)
    assert network.mean_distance(iter(video), iter(video)) == 0
    black, white = np.zeros_like(video), np.full_like(video, 255)
    assert network.mean_distance(iter(black), iter(white)) == pytest.approx(2)


def test_videos_of_different_length_are_no_pairs(tmp_path, video):
    with pytest.raises(ValueError, match="shorter"):
        load(PairStub(), tmp_path).mean_distance(iter(video), iter(video[:8]))


def test_a_file_without_a_stated_hash_is_refused_with_the_reason(tmp_path):
    path = tmp_path / "network.pt"
    write(ImageStub(), path)
    with pytest.raises(InputError, match=r"program that runs when it is loaded.*SHA-256"):
        NetworkFile.parse(str(path))


def test_another_hash_than_stated_is_refused_before_anything_is_loaded(tmp_path, monkeypatch):
    path = tmp_path / "network.pt"
    write(ImageStub(), path)
    monkeypatch.setattr(torch.jit, "load", lambda *_, **__: pytest.fail("the file was loaded"))
    with pytest.raises(InputError, match=r"not loaded.*runs code"):
        Network(NetworkFile(path, "0" * 64))


def test_a_missing_file_is_refused_by_name(tmp_path):
    with pytest.raises(InputError, match=r"no network '.*nowhere\.pt'"):
        NetworkFile.parse(f"{tmp_path / 'nowhere.pt'}:{'0' * 64}")


def test_what_is_no_torchscript_is_refused(tmp_path):
    path = tmp_path / "network.pt"
    path.write_bytes(b"not a network")
    with pytest.raises(InputError, match="not TorchScript"):
        Network(NetworkFile(path, hashlib.sha256(path.read_bytes()).hexdigest()))


@pytest.mark.parametrize(
    ("module", "complaint"),
    [
        (torch.nn.Linear(7, 2), "does not take"),
        (torch.nn.Identity(), "not one vector for each"),
        (torch.nn.Flatten(0), "one row for each input"),
    ],
)
def test_a_network_for_something_else_is_refused(tmp_path, video, module, complaint):
    with pytest.raises(InputError, match=complaint):
        load(module, tmp_path).image_features(iter(video))
