"""Statistics against values worked out by hand and SciPy's definitions."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from ear_jax.runs.statistics import bootstrap_interval, interquartile_mean, probability_of_improvement


def mean(scores: np.ndarray) -> np.ndarray:
    return scores.mean((-2, -1))


@pytest.mark.parametrize(
    ("scores", "expected"),
    [
        ([[1, 2, 3, 4], [5, 6, 7, 8]], 4.5),  # the two lowest and the two highest of eight are dropped
        ([[9, 1, 5, 2, 100]], (2 + 5 + 9) / 3),  # one at either end of five
        ([[4, 6, 8]], 6.0),  # none of three
        ([[-7]], -7.0),
    ],
)
def test_interquartile_mean_by_hand(scores, expected):
    assert interquartile_mean(np.array(scores)) == pytest.approx(expected)


@pytest.mark.parametrize("shape", [(1, 1), (3, 10), (5, 24), (7, 3)])
def test_interquartile_mean_is_scipys_trimmed_mean_also_over_leading_axes(shape):
    scores = np.random.default_rng(0).normal(size=(4, *shape))
    expected = [stats.trim_mean(one, 0.25, axis=None) for one in scores]
    np.testing.assert_allclose(interquartile_mean(scores), expected, rtol=1e-12)


def test_probability_of_improvement_by_hand():
    ours, theirs = np.array([[1, 5], [2, 5]]), np.array([[2, 1], [3, 1], [0, 9]])
    first = (0 + 0 + 1 + 0.5 + 0 + 1) / 6  # 1 and 2 against 2, 3 and 0
    second = (1 + 1 + 0 + 1 + 1 + 0) / 6
    assert probability_of_improvement(ours, theirs) == pytest.approx((first + second) / 2)
    assert probability_of_improvement(theirs, ours) == pytest.approx(1 - (first + second) / 2)
    assert probability_of_improvement(ours, ours) == 0.5


def test_probability_of_improvement_is_mann_and_whitneys_statistic():
    rng = np.random.default_rng(1)
    ours, theirs = rng.integers(0, 6, (9, 1)), rng.integers(0, 6, (7, 1))
    expected = stats.mannwhitneyu(ours[:, 0], theirs[:, 0]).statistic / (9 * 7)
    assert probability_of_improvement(ours, theirs) == pytest.approx(expected)


def test_seeds_are_drawn_within_a_task():
    """Tasks differ and seeds do not, so the interval has no width."""
    scores = np.tile([-50.0, -200.0, -600.0], (3, 1))
    assert bootstrap_interval(mean, scores) == pytest.approx((-850 / 3, -850 / 3))


def test_each_task_draws_its_own_seeds():
    """If seeds were drawn for all tasks at once, the mean of opposite tasks would never change."""
    low, high = bootstrap_interval(mean, np.array([[0.0, 1.0], [1.0, 0.0]]))
    assert (low, high) == (0.0, 1.0)


def test_an_interval_of_a_mean_is_as_wide_as_theory_has_it():
    scores = np.random.default_rng(2).normal(size=(100, 1))
    low, high = bootstrap_interval(mean, scores)
    assert high - low == pytest.approx(2 * 1.96 * scores.std() / 10, rel=0.08)
    assert low < scores.mean() < high


def test_equal_seeds_give_equal_intervals_and_others_differ():
    scores = np.random.default_rng(3).normal(size=(4, 5))
    again = bootstrap_interval(interquartile_mean, scores)
    assert bootstrap_interval(interquartile_mean, scores) == again
    assert bootstrap_interval(interquartile_mean, scores, seed=1) != again


def test_two_methods_are_resampled_each_by_itself():
    ours, theirs = np.array([[3.0], [4.0]]), np.array([[1.0], [2.0], [0.0]])
    assert bootstrap_interval(probability_of_improvement, ours, theirs) == (1.0, 1.0)
    low, high = bootstrap_interval(probability_of_improvement, np.array([[0.0], [2.0]]), np.array([[1.0], [1.0]]))
    assert (low, high) == (0.0, 1.0)
