"""The families' task sets: their order, how new tasks are drawn, and the words that name them."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from ear_jax.envs import FAMILIES, Family, make_family
from ear_jax.errors import UsageError


@cache
def family(name: str) -> Family:
    return make_family(name, "native")


def test_training_tasks_in_the_order_of_their_codes():
    numbers = {name: family(name).training_tasks() for name in FAMILIES}
    assert numbers["halfcheetah-vel"].names == [f"vel-{speed}" for speed in range(1, 11)]
    np.testing.assert_array_equal(numbers["halfcheetah-vel"].params["velocity"], np.arange(1, 11))
    for name in ("hopper-vel", "walker-vel"):
        np.testing.assert_allclose(numbers[name].params["velocity"], 0.2 * np.arange(1, 11), rtol=1e-6)
        assert numbers[name].targets == pytest.approx(0.2 * np.arange(1, 11))
    angles = np.radians(15 * np.arange(24))
    assert numbers["ant-dir"].targets == [15.0 * step for step in range(24)]
    np.testing.assert_allclose(numbers["ant-dir"].params["x"], np.cos(angles), atol=1e-7)
    np.testing.assert_allclose(numbers["ant-dir"].params["y"], np.sin(angles), atol=1e-7)
    both = numbers["halfcheetah-run-jump"]
    assert both.names == [f"back-{speed}" for speed in range(1, 8)] + ["jump-1", "jump-5", "jump-10"]
    np.testing.assert_array_equal(both.params["velocity"], [-1, -2, -3, -4, -5, -6, -7, 0, 0, 0])
    np.testing.assert_array_equal(both.params["run"], [1] * 7 + [0] * 3)
    np.testing.assert_array_equal(both.params["jump"], [0] * 7 + [1, 5, 10])
    two = family("halfcheetah-run-jump").parse_task("both-2-5")
    assert (two.target, two.params) == (-2.0, {"run": 1.0, "velocity": -2.0, "jump": 5.0})
    assert numbers["reach"].names == [f"goal-{angle}" for angle in range(0, 360, 36)]


@pytest.mark.parametrize(
    ("name", "count", "low", "high"),
    [
        ("halfcheetah-vel", 3, 1, 10),
        ("ant-dir", 5, 0, 359),
        ("hopper-vel", 3, 0.2, 2),
        ("walker-vel", 3, 0.2, 2),
        ("reach", 3, 0, 359),
    ],
)
def test_adaptation_tasks_are_drawn_from_the_seed(name, count, low, high):
    named = family(name)
    draws = np.array([named.adaptation_tasks(seed).targets for seed in range(40)])
    assert draws.shape == (40, count)
    assert named.adaptation_tasks(3).targets == list(draws[3])
    assert len({tuple(draw) for draw in draws}) == 40
    assert draws.min() >= low
    assert draws.max() <= high
    assert np.ptp(draws) > 0.8 * (high - low)
    assert not np.isin(draws, named.training_tasks().targets).any(), "tasks not trained on"
    if family(name).period:
        np.testing.assert_array_equal(draws, draws.astype(int))


@pytest.mark.parametrize(
    ("name", "words", "task"),
    [
        ("halfcheetah-vel", ("2.5", "vel-2.5", "2.5m/s", " 2.5 m/s ", "VEL-2.5"), "vel-2.5"),
        ("walker-vel", ("0.4", "vel-0.4"), "vel-0.4"),
        ("hopper-vel", ("-1",), "vel--1"),
        ("ant-dir", ("45", "45deg", "dir-45", "45°", "405", "45 degrees"), "dir-45"),
        ("ant-dir", ("-15", "345"), "dir-345"),
        ("ant-dir", ("360",), "dir-0"),
        ("reach", ("90", "goal-90", "90°", "-270"), "goal-90"),
        ("halfcheetah-run-jump", ("back-3", "BACK-3"), "back-3"),
        ("halfcheetah-run-jump", ("walk", "back-1"), "back-1"),
        ("halfcheetah-run-jump", ("jump",), "jump-10"),
        ("halfcheetah-run-jump", ("both-2-5", "BOTH-2.0-5"), "both-2-5"),
    ],
)
def test_tasks_by_the_words_people_use(name, words, task):
    named = family(name)
    assert {named.parse_task(word).name for word in words} == {task}


@pytest.mark.parametrize("name", FAMILIES)
@pytest.mark.parametrize("word", ["", "fast", "nan", "inf", "vel-", "dir-north", "back-9", "both-2"])
def test_words_that_name_no_task(name, word):
    with pytest.raises(UsageError, match=r"task .*there are|no task .* name a"):
        family(name).parse_task(word)
