"""Whole episodes from random starts: their returns, lengths and mean outcomes."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from ear_jax.agents import Agent
from ear_jax.agents.networks import Params
from ear_jax.envs.batched_env import BatchedEnv, EnvState, Transition
from ear_jax.envs.family import Family, Outcome
from ear_jax.learning.rollout import act_with, first_episode, rollout, score
from ear_jax.tasks import TaskParams


@struct.dataclass
class Episodes:
    """Results of episodes, each leaf [rows, episodes]."""

    returns: jax.Array  # undiscounted
    lengths: jax.Array  # int32, steps until termination or the time limit
    late: Outcome  # outcomes averaged over the second half of each episode
    whole: Outcome  # outcomes averaged over each episode


def play(
    family: Family,
    agent: Agent,
    policy: Params,
    codes: jax.Array,
    tasks: TaskParams,
    key: jax.Array,
    episodes: int,
    explore: bool = False,
) -> Episodes:
    """Plays whole episodes; each row acts under its own code and is scored for its own task.

    Args:
      family: the environment.
      agent, policy: the agent and its policy's parameters.
      codes: [rows, code].
      tasks: each leaf [rows].
      key: random key of the starts, and of the actions if `explore`.
      episodes: episodes per row.
      explore: sample actions instead of taking tanh of the policy's mean.
    """
    shape = (family.episode_length, codes.shape[0], episodes, family.action_size)
    noise = jax.random.normal(jax.random.split(key)[1], shape) if explore else jnp.zeros(shape)
    return play_from(family, agent, policy, codes, tasks, starts(family, tasks, key, episodes), noise)


def starts(family: Family, tasks: TaskParams, key: jax.Array, episodes: int) -> EnvState:
    """Draws the starts of `play`, [rows, episodes].

    On the native engine JAX can cache this program, which takes as long to compile as the episodes themselves.
    """
    return BatchedEnv(family).start(jax.random.split(key)[0], tasks, episodes)


def play_from(
    family: Family,
    agent: Agent,
    policy: Params,
    codes: jax.Array,
    tasks: TaskParams,
    env_states: EnvState,
    noise: jax.Array,
) -> Episodes:
    """Plays whole episodes from given starts [rows, episodes] as `play` does; noise [steps, rows, episodes, act]."""
    outcome, playing = record_from(family, agent, policy, codes, env_states, noise)
    lengths = jnp.sum(playing, axis=0)
    reward = score(family, outcome, tasks, axis=1)
    late = jnp.moveaxis(late_steps(lengths, len(noise)), -1, 0)

    def mean_over(mask: jax.Array) -> Outcome:
        count = jnp.maximum(jnp.sum(mask, axis=0), 1)
        return jax.tree.map(lambda leaf: jnp.sum(jnp.where(mask, leaf, 0.0), axis=0) / count, outcome)

    returns = jnp.sum(jnp.where(playing, reward, 0.0), axis=0)
    return Episodes(returns, lengths, mean_over(late), mean_over(playing))


def record_from(
    family: Family, agent: Agent, policy: Params, codes: jax.Array, env_states: EnvState, noise: jax.Array
) -> tuple[Outcome, jax.Array]:
    """Plays episodes as `play_from` does, and returns the outcome of every step and whether it is part of an episode.

    Returns:
      Outcomes by name, and a bool that is False past the end of an episode, all [steps, rows, episodes].
    """

    def record(transition: Transition) -> tuple[Outcome, jax.Array, jax.Array]:
        return transition.outcome, transition.failed, transition.valid

    act = act_with(agent, policy, codes)
    _, (outcome, failed, valid) = rollout(BatchedEnv(family, resets=False), act, env_states, noise, record)
    return outcome, first_episode(failed) & valid


def late_steps(lengths: Any, steps: int) -> Any:
    """Marks the steps in the second half of episodes of given lengths [...], of NumPy or JAX; bool [..., steps]."""
    step = np.arange(steps)
    return (lengths[..., None] // 2 <= step) & (step < lengths[..., None])


def achieved(family: Family, played: Episodes) -> jax.Array:
    """Returns the commanded quantity [rows] of each row's mean outcomes; angles of 359° and 1° thus average to 0°."""
    late, whole = (jax.tree.map(lambda leaf: leaf.mean(axis=-1), means) for means in (played.late, played.whole))
    return family.achieved(late, whole)
