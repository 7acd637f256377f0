import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from dwgs.scene import InputError
from generator.training.cache import Cache, encode, write_cache
from generator.training.config import ClipConfig, TrainingConfig
from generator.training.log import Log
from generator.training.loop import Saved, Stepped, Trainer, Validated
from generator.training.objective import Batch, Draw, loss_of
from generator.wan.adapter import load_adapter
from generator.wan.clip import Clip
from generator.wan.encode import ControlLatents
from generator.wan.weights import Backbone

CONFIG = TrainingConfig(steps=6, batch=2, at_once=2, rate=1e-3, warmup=2, ema=0.5, precision="no", checkpoint_every=3)


@pytest.fixture
def train(cache, backbone_folder, tmp_path):
    """Trains into a folder of that name, up to so many steps; gives the trainer and its events."""

    def run(name="run", upto=None, **changes):
        trainer = Trainer(cache, Backbone.open(backbone_folder), replace(CONFIG, **changes), tmp_path / name)
        log, events = Log(tmp_path / name, trainer.step), []
        for event in trainer.run():
            events.append(event)
            log.write(event)
            if upto is not None and event.step > upto:  # killed on the way to its next checkpoint
                break
        return trainer, events

    return run


def test_a_clip_comes_back_from_its_shard(cache, clips, codec, clip_config):
    sample = encode(clips[4], codec, clip_config)
    again = cache[4]
    assert again.name == sample.name == "noise/car-4/4x1"
    torch.testing.assert_close(again.target, sample.target, rtol=0.01, atol=0.01)
    for mask in ("reactive_mask", "point_mask", "given_mask"):
        assert np.array_equal(getattr(again, mask), getattr(sample, mask))


def test_what_is_learnt_from_is_what_generating_is_told(cache, clips, codec):
    told = ControlLatents.of(Clip.of(clips[0].frames), codec, "group").for_adapter()
    taught = cache[0].control(aware=False, mask_time="group").for_adapter()
    torch.testing.assert_close(taught, told, rtol=0.01, atol=0.01)


def test_an_aware_clip_is_given_every_fourth_frame(cache, clip_config):
    sample = cache[0]
    assert clip_config.given == (0, 4, 8)
    assert replace(clip_config, strategy="autoregressive").given == (0,)
    assert np.array_equal(sample.given_mask[[0, 4, 8]], sample.reactive_mask[[0, 4, 8]])
    assert np.array_equal(sample.given_mask[[1, 2, 3]], sample.point_mask[[1, 2, 3]])
    assert not torch.equal(sample.given_points, sample.points)


def test_chance_is_the_same_for_the_same_key_and_follows_the_config(cache):
    config = TrainingConfig()
    one, two = (Draw.of(cache[0], config, (5, 1)) for _ in range(2))
    assert torch.equal(one.noise, two.noise)
    assert one.sigma == two.sigma
    draws = [Draw.of(cache[0], config, (step, 0)) for step in range(3000)]
    assert np.mean([d.dropped for d in draws]) == pytest.approx(0.15, abs=0.02)
    assert np.mean([d.aware for d in draws]) == pytest.approx(0.5, abs=0.03)
    logits = [np.log(d.sigma / (1 - d.sigma)) for d in draws]
    assert np.mean(logits) == pytest.approx(0, abs=0.06)
    assert np.std(logits) == pytest.approx(1, abs=0.05)
    shifted = [Draw.of(cache[0], replace(config, shift=3.0), (step, 0)).sigma for step in range(1000)]
    assert np.mean(shifted) == pytest.approx(0.71, abs=0.02)
    assert not any(Draw.of(cache[2], config, (step, 0)).aware for step in range(50))  # stride 4


def test_the_exact_flow_costs_nothing_and_a_dropped_clip_sees_the_null_of_guidance(cache):
    samples, noise = [cache[0], cache[1]], torch.randn_like(cache[0].target)
    draws = [Draw(0.3, False, False, noise), Draw(0.8, True, True, noise)]
    batch = Batch.of(samples, draws, cache.grey(), "group")
    torch.testing.assert_close(batch.noisy[:1], 0.7 * samples[0].target + 0.3 * noise)

    def exact(hidden_states, timestep, **_):
        sigma = (timestep / 1000).view(-1, 1, 1, 1, 1)
        data = torch.cat([s.target for s in samples])
        return ((hidden_states - data) / sigma,)

    assert loss_of(exact, batch, torch.zeros(1, 2, 16)) < 1e-9
    null = samples[1].control(True, "group").without_points(cache.grey()).for_adapter()
    assert torch.equal(batch.control[1:], null)


def test_a_training_that_was_killed_ends_bit_by_bit_as_if_it_had_not_been(train, tmp_path):
    straight, events = train("straight")
    train("broken", upto=4)
    resumed, _ = train("broken")
    for (name, ours), theirs in zip(straight.parameters.items(), resumed.parameters.values(), strict=True):
        assert torch.equal(ours, theirs), name
    states = [tmp_path / run / "checkpoints" / "00000006" for run in ("straight", "broken")]
    ours, theirs = (load_file(state / "state.safetensors") for state in states)
    assert all(torch.equal(ours[name], theirs[name]) for name in ours | theirs)
    logs = [(tmp_path / run / "log.jsonl").read_text() for run in ("straight", "broken")]
    assert logs[0] == logs[1]
    steps = [event.step for event in events if isinstance(event, Stepped)]
    assert steps == [1, 2, 3, 4, 5, 6]


def test_only_the_adapter_learns(train, backbone_folder):
    trainer, events = train()
    before = Backbone.open(backbone_folder).load_transformer().state_dict()
    after = trainer.transformer.state_dict()
    kept = [name for name in before if not name.startswith("vace_")]
    assert all(torch.equal(before[name], after[name]) for name in kept)
    changed = [name for name in before if name.startswith("vace_blocks") and not torch.equal(before[name], after[name])]
    assert changed
    assert [type(event) for event in events[-2:]] == [Validated, Saved]


def test_what_was_seen_often_is_learnt(train):
    trainer, _ = train(steps=1)
    first = trainer.validate()
    trainer.teaching = trainer.held_out  # on purpose: can it learn one clip by heart?
    trainer.config = replace(trainer.config, steps=61, rate=3e-3, dropout=0.0, checkpoint_every=100)
    for _ in trainer.run():
        pass
    assert trainer.validate() < 0.8 * first


def test_the_exported_adapter_is_the_average_and_fits_its_backbone(train, tmp_path):
    trainer, _ = train()
    backbone, folder = trainer.export(tmp_path / "out")
    loaded = load_adapter(folder, Backbone.open(backbone).load_transformer())
    with trainer.averaged():
        for ours, theirs in zip(trainer.adapter.parameters(), loaded.parameters(), strict=True):
            assert torch.equal(ours, theirs)
    assert not torch.equal(next(loaded.parameters()), next(trainer.adapter.parameters()))


def test_everything_can_learn_and_is_exported_with_its_backbone(train, tmp_path):
    trainer, _ = train(trains="all", steps=2)
    backbone, folder = trainer.export(tmp_path / "out")
    opened = Backbone.open(backbone)
    load_adapter(folder, opened.load_transformer())
    with pytest.raises(InputError, match="of the same shape, has"):
        load_adapter(folder, trainer.backbone.load_transformer())


def test_clips_of_a_step_may_go_one_after_another(train):
    together, one_by_one = (train(f"by-{n}", steps=3, batch=3, at_once=n) for n in (3, 2))
    for ours, theirs in zip(together[1], one_by_one[1], strict=True):
        if isinstance(ours, Stepped):
            assert ours.loss == pytest.approx(theirs.loss, rel=1e-5)
    for ours, theirs in zip(together[0].parameters.values(), one_by_one[0].parameters.values(), strict=True):
        torch.testing.assert_close(ours, theirs, atol=2e-5, rtol=1e-4)


def test_every_clip_is_seen_once_in_each_epoch(train):
    trainer, _ = train(steps=1)
    count = len(trainer.teaching)
    assert (count, len(trainer.held_out)) == (8, 1)
    seen = [number for step in range(count) for _, number in trainer.clips_of_step(step)]
    assert sorted(seen[:count]) == sorted(seen[count:]) == trainer.teaching
    assert seen[:count] != seen[count:]


@pytest.mark.filterwarnings("ignore:Mismatch dtype between input and weight")  # torch: no fused kernel for it
def test_arithmetic_in_16_bits_keeps_the_weights_in_32(train):
    trainer, events = train(precision="bf16", steps=2)
    assert {p.dtype for p in trainer.parameters.values()} == {torch.float32}
    assert all(np.isfinite(event.loss) for event in events if isinstance(event, Stepped))


def test_a_network_is_not_shared_out_among_one(cache, backbone_folder, tmp_path):
    with pytest.raises(InputError, match="among several processes, there is one; launch with torchrun"):
        Trainer(cache, Backbone.open(backbone_folder), CONFIG, tmp_path, sharded=True)


def test_looking_takes_a_bounded_time_and_goes_all_over_what_is_held_out(cache, backbone_folder, tmp_path, monkeypatch):
    for held, looked in ((0, 0), (5, 5), (32, 32), (33, 17), (1000, 32)):
        monkeypatch.setattr(Cache, "split", lambda self, held=held: ([0, 1], list(range(held))))
        chosen = Trainer(cache, Backbone.open(backbone_folder), CONFIG, tmp_path / "looks").held_out
        assert len(chosen) == looked
        assert held < 33 or chosen[-1] >= 0.9 * held


def test_another_training_in_the_same_folder_is_refused(train):
    train(steps=1)
    with pytest.raises(InputError, match=r"holds a training with rate 0.001, not 0.1"):
        train(steps=1, rate=0.1)


def test_a_damaged_checkpoint_is_named(train, tmp_path):
    train(steps=1)
    file = tmp_path / "run" / "checkpoints" / "00000001" / "state.safetensors"
    file.write_bytes(file.read_bytes()[:-5])
    with pytest.raises(InputError, match=r"checkpoint '.*' is damaged"):
        train(steps=2)


def test_a_damaged_cache_is_refused(cache, clips, codec, clip_config, tmp_path):
    write_cache(clips[:2], codec, clip_config, tmp_path)
    shard = tmp_path / "00000000.tar"
    data = shard.read_bytes()
    start = data.index(b'{"')
    shard.write_bytes(data[:start] + b"??" + data[start + 2 :])
    with pytest.raises(InputError, match=r"clip 0 of '.*' is damaged"):
        Cache(tmp_path)[0]
    shard.unlink()
    with pytest.raises(InputError, match="lacks clip 0 of 2"):
        Cache(tmp_path)
    index = json.loads((cache.folder / "index.json").read_text())
    (tmp_path / "index.json").write_text(json.dumps({**index, "shape": "wide"}))
    with pytest.raises(InputError, match="lacks or garbles"):
        Cache(tmp_path)
    with pytest.raises(InputError, match="there are none; give longer drives"):
        write_cache([], codec, clip_config, tmp_path)


def test_impossible_numbers_are_refused():
    with pytest.raises(InputError, match=r"1 \+ 4 k frames"):
        ClipConfig(frames=10)
    with pytest.raises(InputError, match="at least 1"):
        TrainingConfig(steps=0)
    with pytest.raises(InputError, match="shares of 0 to 1"):
        TrainingConfig(dropout=2)
    assert [TrainingConfig().rate_at(step) for step in (0, 49, 99, 5000)] == pytest.approx([1e-7, 5e-6, 1e-5, 1e-5])
