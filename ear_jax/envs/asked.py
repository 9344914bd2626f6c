"""A family whose tasks are rewards that a user asks for, instead of its own."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ear_jax.envs.expression import parse_expression
from ear_jax.envs.family import Family, Outcome
from ear_jax.envs.user_code import user_code
from ear_jax.errors import UsageError, plain
from ear_jax.tasks import Task, TaskParams, TaskSet, task_set

Reward = Callable[[Outcome], Any]  # of one outcome, scalars by name; a scalar that JAX can trace


def reward_functions(family: Family, rewards: Sequence[Reward | str]) -> list[Reward]:
    """Returns rewards as functions of one outcome.

    Args:
      family: the family.
      rewards: expressions over its outcomes (`expression`), or functions of one outcome.

    Raises:
      UsageError: an expression has a mistake, a function fails or returns no scalar, a reward is given twice, or none.
    """
    if isinstance(rewards, str) or callable(rewards) or not len(rewards):
        raise UsageError("give a list of at least one reward")
    shapes = family.outcome_shapes
    functions = [parse_expression(reward, shapes) if isinstance(reward, str) else reward for reward in rewards]
    for function in functions:
        with user_code(f"reward {plain(name_of(function))} of the outcomes {', '.join(shapes)} fails", None):
            shape = jax.eval_shape(lambda outcome, function=function: jnp.asarray(function(outcome)), shapes).shape
        if shape != ():
            raise UsageError(f"reward {name_of(function)} must be a scalar, not an array of shape {shape}")
    alike = [getattr(function, "text", function) for function in functions]
    for function, one in zip(functions, alike, strict=True):
        if alike.count(one) > 1:
            raise UsageError(f"reward {plain(name_of(function))!r} is given twice")
    return functions


def asked(family: Family, rewards: Sequence[Reward]) -> tuple[Family, TaskSet]:
    """Returns a copy of a family that scores outcomes by given rewards, and its tasks: one for each reward."""

    def reward(outcome: Outcome, task: TaskParams) -> jax.Array:
        values = jnp.stack([jnp.asarray(function(outcome), jnp.float32) for function in rewards])
        return values[task["reward"].astype(int)]

    asking = copy.copy(family)
    vars(asking)["reward"] = reward  # hides the method of its class
    return asking, task_set([Task(name, None, {"reward": float(row)}) for row, name in enumerate(names_of(rewards))])


def score_outcomes(reward: Reward, outcomes: dict[str, np.ndarray], counts: np.ndarray | None = None) -> np.ndarray:
    """Returns the rewards of many outcomes.

    Args:
      reward: of one outcome.
      outcomes: by name, all of one shape.
      counts: a bool of that shape, False for outcomes that do not count and score 0; None: all count.

    Raises:
      UsageError: the reward of an outcome that counts is not a finite number.
    """
    shape = next(iter(outcomes.values())).shape
    flat = {name: jnp.asarray(values.reshape(-1)) for name, values in outcomes.items()}
    of_all = jax.vmap(lambda outcome: jnp.asarray(reward(outcome), jnp.float32))
    rewards = np.asarray(of_all(flat)).reshape(shape)
    counts = np.ones(shape, bool) if counts is None else counts
    if len(wrong := np.argwhere(counts & ~np.isfinite(rewards))):
        at = ", ".join(f"{name} {values[tuple(wrong[0])]:.4g}" for name, values in outcomes.items())
        raise UsageError(f"reward {plain(name_of(reward))!r} is not a finite number at {at}, which some LTE reaches")
    return np.where(counts, rewards, 0.0)


def names_of(rewards: Sequence[Reward]) -> list[str]:
    """Returns the names of rewards; functions of the same name, such as lambdas, are numbered."""
    names = [name_of(reward) for reward in rewards]
    return [f"{name} {row + 1}" if names.count(name) > 1 else name for row, name in enumerate(names)]


def name_of(reward: Reward) -> str:
    """Returns the text of a reward that is an expression, else the function's name."""
    return str(getattr(reward, "text", getattr(reward, "__name__", "reward")))
