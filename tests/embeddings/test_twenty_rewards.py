"""Twenty rewards, chosen before they were tried, that the shipped cheetah is asked for."""

from __future__ import annotations

from pathlib import Path

import pytest

from ear_jax.embeddings.rewards import adapt_to_rewards
from ear_jax.embeddings.search import Search
from ear_jax.runs.trained import load

REWARDS = (
    # Windows of speed.
    "1 if 1.5 < velocity < 2.5 else 0",
    "1 if 3.3 < velocity < 3.9 else 0",
    "1 if 4.8 < velocity < 5.2 else 0",
    "1 if 6.2 < velocity < 7.2 else 0",
    "1 if 8 < velocity < 9 else 0",
    # Speed with a cost.
    "velocity - squared_action",
    "velocity - 2*squared_action",
    "-abs(velocity - 3.6) - 0.1*squared_action",
    "-abs(velocity - 5.5) - 0.1*squared_action",
    "-abs(velocity - 7.5) - 0.5*squared_action",
    # Bands.
    "exp(-(velocity - 2.5)**2)",
    "exp(-4*(velocity - 4.5)**2)",
    "exp(-(velocity - 6.5)**2) - 0.05*squared_action",
    "clip(velocity, 0, 6) - 0.2*squared_action",
    # As slow, as far back and as fast as it can.
    "-abs(velocity)",
    "-velocity",
    "velocity",
    # Two-sided.
    "max(exp(-4*(velocity - 2)**2), 0.8*exp(-4*(velocity - 8)**2))",
    "1 if velocity < 1.5 or velocity > 8.5 else 0",
    "abs(velocity - 5) - squared_action",
)
SHORTFALL = 0.05  # of a search's return, in either sign
EXPECTED = 18


def reaches(answer: float, searched: float, shortfall: float) -> bool:
    """Returns whether an answer's return is at most a share of the searched return's size below it."""
    return answer >= searched - shortfall * abs(searched)


@pytest.mark.slow
def test_the_survey_answers_as_well_as_a_search(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    trained = load(Path("pretrained:halfcheetah-vel"))
    tasks = adapt_to_rewards(trained, REWARDS, Search(), episodes=10)["tasks"]
    returns = [{way: answer["reevaluated"] for way, answer in task["answers"].items()} for task in tasks]
    met = [reaches(row["map"], row["search"], SHORTFALL) for row in returns]
    assert sum(met) >= EXPECTED
    again = adapt_to_rewards(trained, REWARDS[:1], episodes=1)
    assert again["costs"]["map"]["env_steps"] == 0
