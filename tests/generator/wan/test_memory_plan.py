import pytest

from dwgs.scene import InputError
from generator.wan.memory import GB, Footprint, plan_memory, table

CONFIG = {
    "num_attention_heads": 40,
    "attention_head_dim": 128,
    "ffn_dim": 13824,
    "num_layers": 40,
    "vace_layers": [0, 5, 10, 15, 20, 25, 30, 35],
}
PAPER = Footprint.of(CONFIG, 14_288_000_000, 3_050_000_000, (49, 480, 720), 2)


def test_the_paper_s_network_fits_every_usual_card_in_some_way():
    lines = table(PAPER)
    assert ["streamed" in line for line in lines] == [True, False, False, False]
    assert PAPER.weights == pytest.approx(34.7 * GB, rel=0.01)


def test_more_memory_never_needs_a_slower_way():
    order = [("streamed", False), ("streamed", True), ("resident", False), ("resident", True)]
    ranks = []
    for capacity in range(12, 150, 2):
        plan = plan_memory(PAPER, capacity * GB)
        assert plan.needs < capacity * GB
        ranks.append(order.index((plan.weights, plan.batched)))
    assert ranks == sorted(ranks)


def test_eight_bits_halve_the_backbone_only():
    saved = PAPER.needs("resident", False) - PAPER.needs("float8", False)
    assert saved == PAPER.backbone


def test_too_little_memory_is_said_with_what_it_takes():
    with pytest.raises(InputError, match=r"at least 8\.\d GB on the device, it has 6.0 GB"):
        plan_memory(PAPER, 6 * GB)
