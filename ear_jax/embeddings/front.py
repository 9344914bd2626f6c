"""Trade-offs of two rewards all over the LTE sphere, and their Pareto fronts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax
import numpy as np

from ear_jax.embeddings.map import training_ltes
from ear_jax.embeddings.survey import PLACES, find_survey, record_codes
from ear_jax.envs.asked import Reward, names_of, reward_functions, score_outcomes
from ear_jax.errors import UsageError
from ear_jax.learning.episodes import late_steps
from ear_jax.runs.trained import Trained


def trade(trained: Trained, rewards: Sequence[Reward | str], seed: int = 0, places: int = PLACES) -> dict[str, Any]:
    """Measures two rewards under every surveyed LTE and under the training tasks', and finds the Pareto front.

    Args:
      trained: the run.
      rewards: two expressions over the family's outcomes, or functions of one outcome.
      seed: seeds the starts.
      places: number of codes of the survey.

    Returns:
      The document that `ear front --json` prints. Rewards are means a step over the second half of an episode;
      `env_steps` are the survey's, 0 if it was kept.

    Raises:
      UsageError: there are not two rewards, one has a mistake or is not finite, or the agent has no LTE sphere.
      RunError: the episodes do not fit in memory.
    """
    program = trained.program
    functions = reward_functions(program.family, rewards)
    if len(functions) != 2:
        raise UsageError(f"a trade-off is between two rewards, not {len(functions)}")
    survey, env_steps = find_survey(trained, places, seed)
    table = np.asarray(jax.vmap(program.agent.codes)(trained.policies))  # [seeds, tasks, code]
    played = _late_means(functions, survey.outcomes, survey.lengths)
    on_tasks = _late_means(functions, *record_codes(trained, table, seed))
    seeds = [
        {
            "seed": program.config.seed + index,
            "ltes": np.round(survey.codes, 5).tolist(),
            "rewards": np.round(played[index], 4).tolist(),
            "front": pareto_front(played[index]).tolist(),
            "trained": [
                {**task, "rewards": np.round(values, 4).tolist()}
                for task, values in zip(training_ltes(program.tasks, table[index]), on_tasks[index], strict=True)
            ],
        }
        for index in range(program.config.seeds)
    ]
    return {"rewards": names_of(functions), "env_steps": env_steps, "seeds": seeds}


def _late_means(rewards: Sequence[Reward], outcomes: dict[str, np.ndarray], lengths: np.ndarray) -> np.ndarray:
    """Returns the mean of each reward over the second half of every episode, [seeds, places, rewards]."""
    late = late_steps(lengths, next(iter(outcomes.values())).shape[-1])
    totals = [score_outcomes(reward, outcomes, late).sum(axis=-1, dtype=np.float64) for reward in rewards]
    return np.stack(totals, axis=-1) / np.maximum(late.sum(axis=-1, keepdims=True), 1)


def pareto_front(values: np.ndarray) -> np.ndarray:
    """Returns the rows of values [n, 2] that no other matches or beats in both, from the highest in the first on."""
    order = np.lexsort((-values[:, 1], -values[:, 0]))
    highest = np.maximum.accumulate(values[order, 1])
    return order[np.concatenate([[True], values[order, 1][1:] > highest[:-1]])]
