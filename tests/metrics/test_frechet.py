"""Frechet distances."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import sqrtm

from dwgs.metrics import frechet_distance
from dwgs.scene import InputError


def features(seed, count=40, dims=6):
    rng = np.random.default_rng(seed)
    return rng.normal(size=(count, dims)) @ rng.normal(size=(dims, dims)) + rng.normal(size=dims)


def white(seed, count=50, dims=4):
    """Features whose sample mean is exactly zero and whose sample covariance is exactly one."""
    x = np.random.default_rng(seed).normal(size=(count, dims))
    x -= x.mean(0)
    return x @ np.linalg.inv(np.linalg.cholesky(np.cov(x.T))).T


@settings(max_examples=30, deadline=None)
@given(
    st.lists(st.floats(0.1, 5), min_size=4, max_size=4),
    st.lists(st.floats(0.1, 5), min_size=4, max_size=4),
    st.lists(st.floats(-3, 3), min_size=4, max_size=4),
)
def test_axis_aligned_normals_have_the_distance_that_is_known_in_closed_form(a, b, shift):
    a, b, shift = np.array(a), np.array(b), np.array(shift)
    distance = frechet_distance(white(0) * a, white(1, count=70) * b + shift)
    assert distance == pytest.approx((shift**2).sum() + ((a - b) ** 2).sum(), abs=1e-8)


@pytest.mark.parametrize("counts", [(40, 60), (5, 60), (3, 4)], ids=["many", "one few", "both few"])
def test_it_is_the_usual_formula_with_a_matrix_root(counts):
    a, b = features(0, counts[0]), features(1, counts[1])
    covariances = np.cov(a.T), np.cov(b.T)
    root = np.trace(sqrtm(covariances[0] @ covariances[1] + 1e-12 * np.eye(6)).real)
    usual = ((a.mean(0) - b.mean(0)) ** 2).sum() + sum(map(np.trace, covariances)) - 2 * root
    assert frechet_distance(a, b) == pytest.approx(usual, rel=1e-3)


def test_features_are_at_no_distance_from_themselves_in_any_order():
    a = features(0)
    assert frechet_distance(a, a[::-1]) == pytest.approx(0, abs=1e-9)


def test_it_is_symmetric_and_turning_both_changes_nothing():
    a, b = features(0), features(1)
    turn = np.linalg.qr(features(2, 6))[0]
    assert frechet_distance(a, b) == pytest.approx(frechet_distance(b, a))
    assert frechet_distance(a, b) == pytest.approx(frechet_distance(a @ turn, b @ turn))


@pytest.mark.parametrize("shapes", [((1, 4), (9, 4)), ((9, 4), (9, 5)), ((0, 0), (9, 4))])
def test_too_few_features_or_other_ones_are_refused(shapes):
    with pytest.raises(InputError, match="at least two"):
        frechet_distance(*(np.zeros(shape) for shape in shapes))
