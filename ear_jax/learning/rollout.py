"""The one roll-out: training, evaluation and everything that uses a trained policy step the grid through it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from ear_jax.agents import Agent
from ear_jax.agents.networks import Params
from ear_jax.agents.tanh_gaussian import squash
from ear_jax.envs.batched_env import BatchedEnv, EnvState, Transition
from ear_jax.envs.family import Family, Outcome
from ear_jax.tasks import TaskParams

Act = Callable[[jax.Array, jax.Array], jax.Array]


def act_with(agent: Agent, policy: Params, codes: jax.Array) -> Act:
    """A roll-out's policy in which every row of the grid acts under its own code; codes [rows, code]."""

    def one(code: jax.Array, obs: jax.Array, noise: jax.Array) -> jax.Array:
        return squash(agent.distribution(policy, code, obs), noise)

    return lambda obs, noise: jax.vmap(jax.vmap(one, in_axes=(None, 0, 0)))(codes, obs, noise)


def rollout(
    grid: BatchedEnv, act: Act, env_states: EnvState, noise: jax.Array, record: Callable[[Transition], Any]
) -> tuple[EnvState, Any]:
    """Steps the grid as often as there is noise.

    Args:
      grid: the environments.
      act: (obs [rows, envs, obs], noise [rows, envs, act]) → action; with zero noise it takes its most likely action.
      env_states: where the environments stand, [rows, envs].
      noise: standard normal, [steps, rows, envs, act].
      record: what of each transition to keep. Keep little: every step's is stacked.

    Returns:
      Where the environments stand afterwards, and the record with leading axes [steps, rows, envs].
    """

    def step(env_states: EnvState, noise: jax.Array) -> tuple[EnvState, Any]:
        env_states, transition = grid.step(env_states, act(env_states.state.obs, noise))
        return env_states, record(transition)

    return jax.lax.scan(step, env_states, noise)


def first_episode(over: jax.Array, axis: int = 0) -> jax.Array:
    """Marks the steps of each roll-out's first episode, the step that ends it included.

    Args:
      over: bool, whether an episode ended with the step.
      axis: the axis of steps.
    """
    return jnp.cumsum(over, axis=axis) - over == 0


def score(family: Family, outcome: Outcome, tasks: TaskParams, axis: int = 0) -> jax.Array:
    """Scores outcomes, each for the task of its row.

    Args:
      family: whose reward.
      outcome: each leaf [..., rows, ...].
      tasks: each leaf [rows].
      axis: the axis of rows.
    """
    reward, axes = family.reward, jnp.ndim(jax.tree.leaves(outcome)[0])
    for _ in range(axis + 1, axes):
        reward = jax.vmap(reward, in_axes=(0, None))
    reward = jax.vmap(reward)
    for _ in range(axis):
        reward = jax.vmap(reward, in_axes=(0, None))
    return reward(outcome, tasks)
