"""The roll-out used by training, evaluation and all analyses of trained policies."""

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

Act = Callable[[jax.Array, jax.Array], jax.Array]  # obs, noise → action, each [rows, envs, …]
Record = Callable[[Transition], Any]  # of a step of all environments: the part to keep


def act_with(agent: Agent, policy: Params, codes: jax.Array) -> Act:
    """Returns a function that acts under each row's own code; codes [rows, code]."""

    def act(code: jax.Array, obs: jax.Array, noise: jax.Array) -> jax.Array:
        return squash(agent.distribution(policy, code, obs), noise)

    return lambda obs, noise: jax.vmap(jax.vmap(act, in_axes=(None, 0, 0)))(codes, obs, noise)


def act_along(agent: Agent, policy: Params) -> Act:
    """Returns a function that acts without noise; a code for each step, [rows, envs, code], takes the noise's place."""

    def act(code: jax.Array, obs: jax.Array) -> jax.Array:
        distribution = agent.distribution(policy, code, obs)
        return squash(distribution, jnp.zeros_like(distribution.mean))

    return lambda obs, codes: jax.vmap(jax.vmap(act))(codes, obs)


def rollout(
    batched_env: BatchedEnv, act: Act, env_states: EnvState, noise: jax.Array, record: Record
) -> tuple[EnvState, Any]:
    """Steps a batch of environments once for each step of noise.

    Args:
      batched_env: the environments.
      act: (obs [rows, envs, obs], noise [rows, envs, act]) → action [rows, envs, act].
      env_states: the environments' states, [rows, envs].
      noise: standard normal, [steps, rows, envs, act]; zeros give tanh of the policy's mean.
      record: selects the part of each transition to keep. All steps are stacked, so keep little.

    Returns:
      The environments' final states, and the record with leading axes [steps, rows, envs].
    """

    def step(env_states: EnvState, noise: jax.Array) -> tuple[EnvState, Any]:
        env_states, transition = batched_env.step(env_states, act(env_states.state.obs, noise))
        return env_states, record(transition)

    return jax.lax.scan(step, env_states, noise)


def first_episode(over: jax.Array, axis: int = 0) -> jax.Array:
    """Marks the steps of each roll-out's first episode, including the step that ends it.

    Args:
      over: bool, True where a step ends an episode.
      axis: the axis of steps.

    Returns:
      A bool of the same shape.
    """
    return jnp.cumsum(over, axis=axis) - over == 0


def score(family: Family, outcome: Outcome, tasks: TaskParams, axis: int = 0) -> jax.Array:
    """Scores outcomes, each for its row's task.

    Args:
      family: defines the reward.
      outcome: each leaf [..., rows, ...].
      tasks: each leaf [rows].
      axis: the axis of rows.

    Returns:
      Rewards, shaped as a leaf of `outcome`.
    """
    reward, axes = family.reward, jnp.ndim(jax.tree.leaves(outcome)[0])
    for _ in range(axis + 1, axes):
        reward = jax.vmap(reward, in_axes=(0, None))
    reward = jax.vmap(reward)
    for _ in range(axis):
        reward = jax.vmap(reward, in_axes=(0, None))
    return reward(outcome, tasks)
