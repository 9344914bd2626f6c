"""Returns of LTEs for twenty rewards on the shipped cheetah, found from a survey, from imagination and by search.

The rewards are those of `tests/embeddings/test_twenty_rewards.py`. All answers to a reward are played from the same
starts. A row has what one way predicted and returned for one reward; its env steps and seconds are those of all rewards
that were asked for at once, `at_once`.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from benchmarks import common
from ear_jax.cli.exits import exit_code
from ear_jax.embeddings.rewards import adapt_to_rewards
from ear_jax.embeddings.search import Search
from ear_jax.process.environment import start_jax
from ear_jax.runs.trained import Trained, load
from tests.embeddings.test_twenty_rewards import REWARDS

RUN = "pretrained:halfcheetah-vel"
AT_ONCE = 5  # rewards that are searched for in one compiled call
EPISODES = 10  # in which each answer is played


def measure(options: argparse.Namespace, trained: Trained, rewards: Sequence[str], search: Search | None) -> None:
    """Asks for rewards and appends a row for each of them and each way; with a search, only the rows of the search."""
    episodes = 1 if options.quick else EPISODES
    document = adapt_to_rewards(trained, rewards, search, episodes)
    for task in document["tasks"]:
        for way, answer in task["answers"].items():
            if search is None or way == "search":
                row = {
                    "run": RUN,
                    "reward": task["name"],
                    "way": way,
                    "predicted": round(answer["predicted"], 3),
                    "return": round(answer["reevaluated"], 3),
                    "velocity": round(answer["outcome"]["velocity"], 3),
                    "episodes": episodes,
                    "at_once": len(rewards),
                    **document["costs"][way],
                }
                common.write_row(options, "rewards", row)


def main() -> None:
    options = common.arguments(__doc__)
    start_jax()
    trained = load(Path(RUN))
    rewards = REWARDS[:2] if options.quick else REWARDS
    measure(options, trained, rewards, None)
    for first in range(0, len(rewards), AT_ONCE):
        search = Search(epochs=1 if options.quick else 10)
        measure(options, trained, rewards[first : first + AT_ONCE], search)


if __name__ == "__main__":
    sys.exit(exit_code("rewards", main))
