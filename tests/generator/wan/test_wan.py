import shutil
from dataclasses import replace

import numpy as np
import pytest
import torch

from dwgs.scene import InputError, LidarSweep
from generator import backend
from generator.wan import network
from generator.wan.settings import Sampling, WanSettings
from generator.wan.wan import WanGenerator

SAMPLING = Sampling(steps=2)


@pytest.fixture
def settings(backbone_folder, adapter_folder):
    return WanSettings(backbone_folder, adapter_folder, sampling=SAMPLING, devices=("cpu",))


def pixels(scene):
    return np.stack([frame.pixels for frame in scene.all_frames()])


def test_193_frames_are_made_in_two_stages_and_the_recording_is_kept_bit_by_bit(settings, conditions, monkeypatch):
    told = []
    generate = network.Network.generate

    def spy(self, clip, *arguments):
        told.append(clip)
        return generate(self, clip, *arguments)

    monkeypatch.setattr(network.Network, "generate", spy)
    given, progress = conditions(193), []
    edited = WanGenerator(settings).generate(given, 0, lambda *counts: progress.append(counts))
    assert [len(clip.video) for clip in told] == [49] * 5
    assert progress[-1] == (10, 10)
    recorded, mask = pixels(given.scene), np.stack([f.reactive_mask for f in edited.all_frames()])
    made = pixels(edited)
    assert np.array_equal(made[~mask], recorded[~mask])
    assert (made[mask] != recorded[mask]).mean() > 0.9
    anchored = told[1]  # the anchors of the first stage guide the second: dense where points are sparse
    assert np.array_equal(anchored.point_mask[::4], anchored.reactive_mask[::4])
    assert (anchored.point_mask[1::4] != anchored.reactive_mask[1::4]).any()


def test_a_run_that_was_killed_goes_on_and_ends_as_if_it_had_not_been(settings, conditions, tmp_path, monkeypatch):
    given = conditions(97)
    whole = pixels(WanGenerator(settings).generate(given, 3))
    generate, clips = network.Network.generate, []

    def dies(self, clip, *arguments):
        if len(clips) == 2:
            raise KeyboardInterrupt
        clips.append(clip)
        return generate(self, clip, *arguments)

    monkeypatch.setattr(network.Network, "generate", dies)
    with pytest.raises(KeyboardInterrupt):
        WanGenerator(settings, tmp_path / "parts").generate(given, 3)
    assert len(list((tmp_path / "parts").iterdir())) == 2
    monkeypatch.setattr(network.Network, "generate", generate)
    progress = []
    resumed = WanGenerator(settings, tmp_path / "parts").generate(given, 3, lambda *counts: progress.append(counts))
    assert np.array_equal(pixels(resumed), whole)
    assert progress[0] == (2, 6)


def test_whole_frames_are_painted_and_the_masks_still_say_where_the_vehicle_is(settings, conditions, monkeypatch):
    given, told = conditions(5), []
    rng = np.random.default_rng(0)
    ahead = np.stack([rng.uniform(-5, 5, 500), rng.uniform(-3, 3, 500), rng.uniform(9, 20, 500)], 1)
    sweeps = tuple(LidarSweep(ahead.astype(np.float32), np.full(500, t), np.zeros(3), t, i) for i, t in ((2, 0.2),))
    generate = network.Network.generate

    def spy(self, clip, *arguments):
        told.append(clip)
        return generate(self, clip, *arguments)

    monkeypatch.setattr(network.Network, "generate", spy)
    generator = WanGenerator(replace(settings, whole_frame=True))
    with pytest.raises(InputError, match="leave --whole-frame out"):
        generator.check(given.scene)
    lit = replace(given, scene=replace(given.scene, sweeps=sweeps))
    edited = generator.generate(lit, 0)
    (clip,) = told
    assert clip.reactive_mask.all()
    assert clip.point_mask.any(axis=(1, 2)).all()
    assert (pixels(edited) != pixels(given.scene)).any(-1).mean() > 0.9
    masks = [f.load_reactive_mask() for f in given.frames["front"]]
    assert np.array_equal([f.reactive_mask for f in edited.all_frames()], masks)


def test_running_out_of_memory_is_one_sentence_and_keeps_what_is_finished(settings, conditions, tmp_path, monkeypatch):
    generate, clips = network.Network.generate, []

    def grows(self, clip, *arguments):
        if clips:
            torch.empty(2**60)
        clips.append(clip)
        return generate(self, clip, *arguments)

    monkeypatch.setattr(network.Network, "generate", grows)
    with pytest.raises(InputError, match="ran out of memory, more than was planned; finished clips are kept"):
        WanGenerator(settings, tmp_path / "parts").generate(conditions(97), 3)
    assert len(list((tmp_path / "parts").iterdir())) == 1


def test_several_devices_make_the_same_pixels(settings, conditions):
    one, two = (
        pixels(WanGenerator(replace(settings, devices=devices)).generate(conditions(97), 0))
        for devices in (("cpu",), ("cpu", "cpu"))
    )
    assert np.array_equal(one, two)


def test_the_seed_and_the_strategy_matter(settings, conditions):
    given = conditions(53)
    made = [
        pixels(WanGenerator(replace(settings, strategy=strategy)).generate(given, seed))
        for strategy, seed in (("global-to-local", 0), ("global-to-local", 1), ("autoregressive", 0), ("single", 0))
    ]
    for i, ours in enumerate(made):
        for theirs in made[i + 1 :]:
            assert not np.array_equal(ours, theirs)


def test_points_guide_the_adapter_and_vace_sees_none(settings, conditions):
    given = conditions(5)
    hidden = replace(
        given,
        frames={"front": tuple(replace(f, load_point_image=f.load_inactive_image) for f in given.frames["front"])},
    )
    with_points = [pixels(WanGenerator(settings).generate(c, 0)) for c in (given, hidden)]
    assert not np.array_equal(*with_points)
    vace = replace(settings, adapter=None)
    without = [pixels(WanGenerator(vace).generate(c, 0)) for c in (given, hidden)]
    assert np.array_equal(*without)


def test_the_backends_are_known_by_their_names(settings):
    assert backend("wan", settings).name == "wan"
    assert backend("vace", replace(settings, adapter=None)).name == "vace"
    assert backend("wan", settings).capabilities.needs_weights
    with pytest.raises(InputError, match="'wan' needs weights: give --backbone DIR"):
        backend("wan")
    with pytest.raises(InputError, match="'wan' needs a PointAdapter: give --adapter DIR"):
        backend("wan", replace(settings, adapter=None))
    with pytest.raises(InputError, match="'vace' takes no PointAdapter"):
        backend("vace", settings)
    with pytest.raises(InputError, match="'vace' sees no points to paint whole frames by: leave"):
        backend("vace", replace(settings, adapter=None, whole_frame=True))


def test_what_it_needs_is_said_before_anything_is_loaded(settings, conditions, monkeypatch):
    notes = WanGenerator(settings).check(conditions(5).scene)
    assert [note.split()[0] for note in notes[1:-2]] == ["24", "48", "80", "141"]
    assert "on cpu" in notes[-2]
    assert notes[-1] == "2 steps are 4 runs of the network for each clip"
    with pytest.raises(InputError, match=r"multiples of 16, these are 40x32; choose a --size such as 32x32"):
        WanGenerator(settings).check(conditions(5, width=40).scene)
    monkeypatch.setattr("generator.wan.wan._capacity", lambda device: 1e6)
    with pytest.raises(InputError, match=r"take at least .* GB on the device, it has 0.0 GB"):
        WanGenerator(settings).check(conditions(5).scene)


def test_an_adapter_that_does_not_fit_is_refused_before_anything_is_loaded(settings, tmp_path):
    from generator.wan.tiny import write_tiny_backbone

    other, broken = tmp_path / "other", tmp_path / "broken"
    write_tiny_backbone(other, seed=1)
    with pytest.raises(InputError, match="this one, of the same shape, has"):
        WanGenerator(replace(settings, backbone=other))
    shutil.copytree(settings.adapter, broken)
    weights = broken / "diffusion_pytorch_model.safetensors"
    weights.write_bytes(weights.read_bytes()[:-1])
    with pytest.raises(InputError, match="damaged or cut short"):
        WanGenerator(replace(settings, adapter=broken))
    with pytest.raises(InputError, match="no PointAdapter but WanVACETransformer3DModel with 96"):
        WanGenerator(replace(settings, adapter=settings.backbone / "transformer"))


def test_a_backbone_that_is_incomplete_is_refused_in_one_sentence(settings, tmp_path):
    folder = tmp_path / "backbone"

    def refused(match):
        with pytest.raises(InputError, match=match):
            WanGenerator(replace(settings, backbone=folder))

    refused("there is no '.*config.json'; give a model's folder")
    shutil.copytree(settings.backbone, folder)
    weights = folder / "transformer" / "diffusion_pytorch_model.safetensors"
    weights.write_bytes(weights.read_bytes()[:-1])
    refused("damaged or cut short")
    weights.unlink()
    refused("there are none in '.*transformer'; download the model")
    shutil.rmtree(folder)
    shutil.copytree(settings.backbone, folder)
    text = folder / "prompt.safetensors"
    text.write_bytes(text.read_bytes()[:50])
    refused("prompt.safetensors' is damaged .*; delete it")
    text.unlink()
    refused("neither prompt.safetensors nor text_encoder/")
    with pytest.raises(InputError, match="there is no device 'tpu' here"):
        WanGenerator(replace(settings, devices=("tpu",)))
