import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import av
import numpy as np
import pytest
import torch

from generator.training.config import TrainingConfig
from generator.training.log import Log
from generator.training.loop import Trainer, Validated
from generator.training.preview import preview
from generator.wan.weights import Backbone

CONFIG = TrainingConfig(steps=2, batch=2, rate=1e-2, warmup=0, ema=0.5, precision="no", checkpoint_every=1)


@pytest.fixture
def trainer(cache, backbone_folder, tmp_path):
    return Trainer(cache, Backbone.open(backbone_folder), CONFIG, tmp_path)


def test_a_film_shows_the_recording_the_points_and_what_was_painted_in_the_region(trainer, cache, codec):
    (clip,) = preview(trainer)  # one vehicle is held out
    film = clip.film(codec)
    frames, height, width = cache.shape
    assert film.shape == (frames, height, 3 * width, 3)
    recorded, points, painted = np.split(film, 3, 2)
    region = clip.sample.reactive_mask
    assert np.array_equal(recorded, codec.decode(cache[trainer.held_out[0]].target))
    assert np.array_equal(points, codec.decode(clip.sample.points))
    assert np.array_equal(painted[~region], recorded[~region])
    assert (painted[region] != recorded[region]).mean() > 0.5


def test_looking_is_repeatable_and_leaves_the_training_as_it_was(trainer):
    for _ in trainer.run():
        pass
    before = {name: p.detach().clone() for name, p in trainer.parameters.items()}
    averages = [average.clone() for average in trainer.average.shadow_params]
    state = torch.get_rng_state()
    one, two = (preview(trainer)[0].painted for _ in range(2))
    assert torch.equal(one, two)
    assert torch.equal(torch.get_rng_state(), state)
    assert all(torch.equal(before[name], p) for name, p in trainer.parameters.items())
    assert all(torch.equal(*pair) for pair in zip(averages, trainer.average.shadow_params, strict=True))


def test_it_shows_the_average_and_how_it_changes(trainer):
    first = preview(trainer)[0].painted
    for _ in trainer.run():
        pass
    later = preview(trainer)[0].painted
    assert not torch.equal(first, later)
    for average in trainer.average.shadow_params:
        average.zero_()
    assert not torch.equal(preview(trainer)[0].painted, later)


def test_without_held_out_clips_there_is_nothing_to_see(trainer, tmp_path):
    trainer.held_out = []
    assert preview(trainer) == []
    Log(tmp_path, 0).show(1, [])
    assert not (tmp_path / "validation").exists()


def test_clips_are_filmed_one_below_the_other(tmp_path):
    clips = [np.full((5, 32, 144, 3), shade, np.uint8) for shade in (40, 200)]
    Log(tmp_path, 0).show(500, clips)
    with av.open(tmp_path / "validation" / "00000500.mp4") as film:
        frames = [frame.to_ndarray(format="rgb24") for frame in film.decode(video=0)]
    assert np.shape(frames) == (5, 64, 144, 3)
    assert np.mean(frames[2][:32]) == pytest.approx(40, abs=4)
    assert np.mean(frames[2][32:]) == pytest.approx(200, abs=4)


def test_curves_and_stills_go_to_tensorboard_where_it_is_installed(tmp_path, monkeypatch):
    told = []

    class Writer:
        def __init__(self, folder, purge_step):
            told.append((Path(folder).name, purge_step))

        def add_scalar(self, name, value, step):
            told.append((name, value, step))

        def add_image(self, name, image, step, dataformats):
            told.append((name, image.shape, int(image[0, 0, 0]), step, dataformats))

    monkeypatch.setattr("generator.training.log.find_spec", lambda name: name)
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", SimpleNamespace(SummaryWriter=Writer))
    log = Log(tmp_path, 4)
    log.write(Validated(5, 0.25))
    log.show(5, [np.arange(5, dtype=np.uint8).repeat(32 * 144 * 3).reshape(5, 32, 144, 3)])
    assert told == [("tensorboard", 5), ("validated/loss", 0.25, 5), ("validation", (32, 144, 3), 2, 5, "HWC")]


def test_it_shows_different_vehicles_where_they_are_largest(trainer, cache):
    sizes = [np.count_nonzero(cache[i].reactive_mask) for i in range(9)]
    largest = int(np.argmax(sizes))
    trainer.held_out = list(range(9))
    names = [clip.sample.name for clip in preview(trainer)]
    assert names[0] == cache.names[largest]
    assert names[1] in cache.names[:largest] + cache.names[largest + 1 :]
    trainer.held_out = [largest, largest]
    assert [clip.sample.name for clip in preview(trainer)] == [cache.names[largest]]


@pytest.mark.filterwarnings("ignore:Mismatch dtype between input and weight")  # torch: no fused kernel for it
def test_it_reckons_in_16_bits_where_the_training_does(trainer):
    exact = preview(trainer)[0].painted
    trainer.config = replace(trainer.config, precision="bf16")
    rounded = preview(trainer)[0].painted
    assert not torch.equal(rounded, exact)
    assert (rounded - exact).abs().mean() < 0.1 * exact.abs().mean()
