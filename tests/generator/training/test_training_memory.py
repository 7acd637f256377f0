from dataclasses import replace

import pytest

from generator.training.config import TrainingConfig
from generator.training.memory import TrainingFootprint
from generator.wan.memory import GB

WAN_14B = {"num_attention_heads": 40, "attention_head_dim": 128, "ffn_dim": 13824, "num_layers": 40}
WAN_14B["vace_layers"] = [0, 5, 10, 15, 20, 25, 30, 35]
PARAMETERS = (14_288_000_000, 3_050_000_000)
CONFIG = TrainingConfig()


def footprint(processes, sharded, config=CONFIG):
    return TrainingFootprint.of(WAN_14B, PARAMETERS, (49, 480, 720), config, processes, sharded)


def test_the_paper_s_training_fits_141_gb_whole_and_eight_times_48_gb_shared_out():
    whole, shared = footprint(8, False), footprint(8, True)
    assert 80 * GB < whole.total < 130 * GB
    assert shared.total < 40 * GB
    assert whole.frozen == pytest.approx(28.6 * GB, rel=0.01)
    assert (8 * shared.frozen, 8 * shared.learnt) == (whole.frozen, whole.learnt)
    assert str(whole).startswith("104.0 GB: 28.6 frozen weights, 61.0 learning weights")
    assert "brought together" in str(shared)


def test_clips_that_go_through_together_take_more_up_to_a_process_s_share():
    one, two = (footprint(1, False, replace(CONFIG, at_once=n)).activations for n in (1, 2))
    assert two == 2 * one
    assert footprint(8, False, replace(CONFIG, at_once=2)).activations == one


def test_a_backbone_that_learns_takes_twenty_bytes_for_each_parameter():
    everything = footprint(1, False, replace(CONFIG, trains="all"))
    assert everything.frozen == 0
    assert everything.learnt == 20 * sum(PARAMETERS)
