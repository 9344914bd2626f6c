"""Pareto fronts of two rewards, for points and for an agent whose action is the first number of its code."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

from ear_jax.config import Config
from ear_jax.embeddings.front import pareto_front, trade
from ear_jax.errors import UsageError
from ear_jax.learning.episodes import late_steps
from ear_jax.runs.trained import Trained
from ear_jax.runs.training import Program
from tests.helpers.documented import check_keys
from tests.helpers.obedient import CODES, obedient
from tests.helpers.probe import Slider


@pytest.fixture
def toy(tmp_path) -> Trained:
    family = Slider("native")
    program = Program(Config("slider"), family, family.training_tasks(), obedient(CODES), None)  # type: ignore[arg-type]
    return Trained("toy", program, jnp.zeros((1, 1)), 0, tmp_path)


def test_no_point_of_a_front_is_beaten_in_both():
    values = np.array([[0.0, 5.0], [1.0, 4.0], [1.0, 3.0], [0.5, 4.0], [3.0, 1.0], [2.0, 1.0], [3.0, 1.0]])
    assert pareto_front(values).tolist() == [4, 1, 0]


def test_a_front_equals_the_rows_that_none_dominates():
    values = np.random.default_rng(0).normal(size=(200, 2))
    dominated = ((values[None] >= values[:, None]).all(-1) & (values[None] > values[:, None]).any(-1)).any(1)
    assert sorted(pareto_front(values)) == np.flatnonzero(~dominated).tolist()


def test_between_two_wishes_lie_the_codes_that_trade(toy):
    """The rewards are best at the actions 0.3 and −0.3, so every action between them is on the front."""
    document = trade(toy, ["-(action - 0.3)**2", "-(action + 0.3)**2"], places=300)
    check_keys("front", document)
    (seed,) = document["seeds"]
    actions = np.array(seed["ltes"])[:, 0]
    inside = np.flatnonzero(np.abs(actions) < 0.29)
    assert set(inside) <= set(seed["front"])
    assert np.abs(actions[seed["front"]]).max() < 0.33, "the code nearest to 0.3 may lie beyond it"
    first = seed["trained"][0]
    assert first["rewards"] == pytest.approx([-((first["lte"][0] - sign * 0.3) ** 2) for sign in (1, -1)], abs=1e-3)


@pytest.mark.parametrize("rewards", [["action"], ["action", "-action", "1"]])
def test_a_trade_off_has_two_sides(toy, rewards):
    with pytest.raises(UsageError, match=f"between two rewards, not {len(rewards)}"):
        trade(toy, rewards)
    with pytest.raises(UsageError, match="give a list of"):
        trade(toy, lambda outcome: outcome["action"])


def test_the_second_half_of_an_episode_begins_with_its_middle():
    late = late_steps(np.array([0, 1, 4, 5]), 6)
    assert [np.flatnonzero(steps).tolist() for steps in late] == [[], [0], [2, 3], [2, 3, 4]]
