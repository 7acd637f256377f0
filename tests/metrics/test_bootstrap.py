"""Bootstrap intervals."""

import numpy as np

from dwgs.metrics import bootstrap_interval


def test_an_interval_holds_the_mean_and_shrinks_with_more_sequences():
    few, many = [4.0, 6.0] * 3, [4.0, 6.0] * 100
    (a, b), (c, d) = (bootstrap_interval(x, np.mean) for x in (few, many))
    assert a < 5 < b
    assert c < 5 < d
    assert d - c < 0.3 * (b - a)


def test_it_covers_the_truth_about_as_often_as_it_says():
    rng = np.random.default_rng(1)
    intervals = [bootstrap_interval(rng.normal(0, 1, 30).tolist(), np.mean, samples=300) for _ in range(200)]
    assert 0.88 < np.mean([low <= 0 <= high for low, high in intervals]) < 0.98


def test_one_sequence_tells_no_interval():
    assert bootstrap_interval([3.0], np.mean) is None


def test_the_same_seed_gives_the_same_interval():
    values = [1.0, 4.0, 2.0, 8.0]
    assert bootstrap_interval(values, np.mean, seed=3) == bootstrap_interval(values, np.mean, seed=3)


def test_exact_results_stay_exact():
    assert bootstrap_interval([np.inf, np.inf], np.mean) == (np.inf, np.inf)
