"""A scale of reward for each task, so that returns of all tasks have the same size (BRC).

naumix/BiggerRegularizedCategorical divides rewards by the largest return seen. Here the largest return is the largest
mean reward of an environment in an epoch, continued for ever.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

from ear_jax.config import SacConfig
from ear_jax.envs.batched_env import Transition
from ear_jax.envs.family import Family
from ear_jax.learning.rollout import score
from ear_jax.tasks import TaskParams

SMALLEST = 1e-6  # mean reward, so that a task that has only seen 0 is not divided by it


def largest_reward(family: Family, tasks: TaskParams, transitions: Transition, before: jax.Array) -> jax.Array:
    """Returns the largest absolute mean reward of an environment so far, [tasks].

    Args:
      family, tasks: score the transitions, each for its own task.
      transitions: an epoch's, [steps, tasks, envs].
      before: the largest of earlier epochs, [tasks].
    """
    reward = jnp.where(transitions.valid, score(family, transitions.outcome, tasks, axis=1), 0.0)
    return jnp.maximum(before, jnp.max(jnp.abs(jnp.mean(reward, axis=0)), axis=-1))


def reward_scale(config: SacConfig, largest: jax.Array) -> jax.Array:
    """Returns the factor on each task's rewards [tasks]; it scales the return of `largest` to `return_scale`."""
    return config.return_scale * (1 - config.discount) / jnp.maximum(largest, SMALLEST)
