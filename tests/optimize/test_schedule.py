"""The order of views and the length of steps."""

from itertools import islice, pairwise

import pytest

from dwgs.optimize import hold_then_decay, view_order


@pytest.mark.parametrize("count", [1, 2, 3, 7, 49, 169])
def test_each_view_comes_once_in_every_epoch(count):
    draws = list(islice(view_order(count, seed=5), 2 * count))
    assert sorted(draws[:count]) == sorted(draws[count:]) == list(range(count))


def test_a_few_views_in_a_row_are_spread_over_the_clip():
    draws = sorted(islice(view_order(100), 10))
    gaps = [b - a for a, b in pairwise(draws)]
    assert max(gaps) <= 20


def test_the_rate_holds_then_decays_to_its_final_value():
    assert hold_then_decay(0, 100) == hold_then_decay(60, 100) == 1
    assert hold_then_decay(100, 100, final=0.05) == pytest.approx(0.05)
    assert hold_then_decay(80, 100, final=0.04) == pytest.approx(0.2)
