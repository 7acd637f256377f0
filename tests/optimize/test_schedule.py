"""The order of views and the length of steps."""

from itertools import islice, pairwise

import pytest

from dwgs.optimize import count_steps, fill_time, hold_then_decay, view_order


@pytest.mark.parametrize("count", [1, 2, 3, 7, 49, 169])
def test_each_view_comes_once_in_every_epoch(count):
    draws = list(islice(view_order(count, seed=5), 2 * count))
    assert sorted(draws[:count]) == sorted(draws[count:]) == list(range(count))


def test_a_few_views_in_a_row_are_spread_over_the_clip():
    draws = sorted(islice(view_order(100), 10))
    gaps = [b - a for a, b in pairwise(draws)]
    assert max(gaps) <= 20


def test_the_rate_holds_then_decays_to_its_final_value():
    assert hold_then_decay(0.0) == hold_then_decay(0.6) == 1
    assert hold_then_decay(1.0, final=0.05) == pytest.approx(0.05)
    assert hold_then_decay(0.8, final=0.04) == pytest.approx(0.2)


def test_a_schedule_of_steps_ends_with_the_last():
    paces = list(count_steps(4))
    assert [pace.step for pace in paces] == [1, 2, 3, 4]
    assert [pace.progress for pace in paces] == [0.25, 0.5, 0.75, 1.0]


def test_a_schedule_of_seconds_has_the_steps_that_fit_and_runs_to_its_end():
    now = iter(k * 0.3 for k in range(100))  # a step takes 0.3 s
    paces = list(fill_time(3.0, clock=lambda: next(now)))
    assert [pace.step for pace in paces] == list(range(1, 11))
    assert paces[-1].progress == 1
    assert paces[4].steps == 10
    progress = [pace.progress for pace in paces]
    assert progress == sorted(progress)
