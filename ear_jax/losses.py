"""The SAC objectives as free functions of a batch: what is differentiated first, data next, noise last.

Numbers of equations are the paper's (appendix A). Every batch is [n]; per-item functions are vmapped here.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from flax import struct

from ear_jax.agents import Agent
from ear_jax.networks import Params
from ear_jax.policy import sample


@struct.dataclass
class Batch:
    """Transitions scored for the tasks they are to teach."""

    obs: jax.Array  # [n, obs]
    action: jax.Array  # [n, act]
    next_obs: jax.Array  # [n, obs]
    reward: jax.Array  # [n]
    terminated: jax.Array  # bool [n]
    task: jax.Array  # int32 [n]


@struct.dataclass
class Noise:
    """Standard normal noise for one evaluation of the policy on a batch."""

    action: jax.Array  # [n, act]
    code: jax.Array  # [n, code]


def sample_policy(
    policy: Params, agent: Agent, table: jax.Array, obs: jax.Array, task: jax.Array, noise: Noise
) -> tuple[jax.Array, jax.Array]:
    """Actions [n, act] and log-densities [n], each under its task's perturbed code of the table (algorithm 1)."""

    def one(obs, task, noise):
        code = agent.project(table[task] + agent.code_noise * noise.code)
        return sample(agent.distribution(policy, code, obs), noise.action)

    return jax.vmap(one)(obs, task, noise)


def q_values(critics: Params, agent: Agent, obs: jax.Array, action: jax.Array, task: jax.Array) -> jax.Array:
    """Every critic's value, [critics, n]; `task` [n, ·] is what critics know each item's task by.

    Critics are the outer axis: each layer is then one batched matmul of all of them, without a transposition between.
    """
    of_batch = jax.vmap(agent.value, in_axes=(None, 0, 0, 0))
    return jax.vmap(of_batch, in_axes=(0, None, None, None))(critics, obs, action, task)


def believed(values: jax.Array, pessimism: float) -> jax.Array:
    """What all critics' values [critics, n] come to: at 1 the least, as in SAC, at 0 their mean, between both; [n].

    The mean is what Nauman et al. (2024, arXiv 2405.16158) recommend where critics are regularised otherwise.
    """
    return pessimism * jnp.min(values, axis=0) + (1 - pessimism) * jnp.mean(values, axis=0)


def td_target(
    batch: Batch, next_value: jax.Array, next_log_prob: jax.Array, temperature: jax.Array, discount: float
) -> jax.Array:
    """r + γ V̄(s′), V̄ = Q̄ − α log π (equation 5), and no V̄ after a termination; a time limit is none. [n]

    Args:
      batch: the transitions.
      next_value: what is believed of the next action, [n].
      next_log_prob: that action's log-density, [n].
      temperature: α of each item's task, [n], or one for all.
      discount: γ.
    """
    value = next_value - temperature * next_log_prob
    return batch.reward + discount * jnp.where(batch.terminated, 0.0, value)


def critic_loss(values: jax.Array, target: jax.Array) -> jax.Array:
    """J_Q (equation 4): ½ (Q − target)², the mean over the batch and the sum over independent critics."""
    return jnp.sum(jnp.mean(0.5 * (values - target) ** 2, axis=-1))


def actor_loss(value: jax.Array, log_prob: jax.Array, temperature: jax.Array) -> jax.Array:
    """J_π (equation 3): the mean of α log π − Q, of what is believed of Q; all [n]."""
    return jnp.mean(temperature * log_prob - value)


def temperature_loss(log_temperature: jax.Array, log_prob: jax.Array, target_entropy: float) -> jax.Array:
    """J(α) (equation 2): the mean of −α (log π + H̄), with α in its logarithm so that it stays positive."""
    return jnp.mean(-log_temperature * (log_prob + target_entropy))
