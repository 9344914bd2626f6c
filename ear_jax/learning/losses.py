"""The SAC objectives as free functions of a batch: the parameters differentiated first, data next, noise last.

Equation numbers are the paper's (appendix A). Every batch is [n]; functions of one item are vmapped here.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp

from ear_jax.agents import Agent
from ear_jax.agents.critic import Critic, Prediction
from ear_jax.agents.networks import Params
from ear_jax.agents.tanh_gaussian import sample
from ear_jax.learning.batch import Batch, Noise


def sample_policy(
    policy: Params, agent: Agent, table: jax.Array, obs: jax.Array, task: jax.Array, noise: Noise
) -> tuple[jax.Array, jax.Array]:
    """Samples actions [n, act] and log-densities [n], each under its task's perturbed code (algorithm 1)."""

    def one(obs, task, noise):
        code = agent.project(table[task] + agent.code_noise * noise.code)
        return sample(agent.distribution(policy, code, obs), noise.action)

    return jax.vmap(one)(obs, task, noise)


def predictions(critics: Params, critic: Critic, obs: jax.Array, action: jax.Array, task: jax.Array) -> Prediction:
    """Returns every critic's prediction, each leaf [critics, n, …]; `task` [n, ·] is how critics know the task.

    Critics are the outer axis: each layer is then one batched matmul without a transposition between.
    """
    of_batch = jax.vmap(critic.predict, in_axes=(None, 0, 0, 0))
    return jax.vmap(of_batch, in_axes=(0, None, None, None))(critics, obs, action, task)


def q_values(critic: Critic, predictions: Prediction) -> jax.Array:
    """Returns Q [critics, n] of predictions with these leading axes."""
    return jax.vmap(jax.vmap(critic.value))(predictions)


def td_target(
    next_value: jax.Array,
    reward: jax.Array,
    terminated: jax.Array,
    next_log_prob: jax.Array,
    temperature: jax.Array,
    discount: float,
) -> jax.Array:
    """Returns r + γ V̄(s′) with V̄ = Q̄ − α log π (equation 5), and r alone after a termination.

    A time limit is no termination. For one item: `next_value` may have any shape, the others are scalars.
    """
    value = next_value - temperature * next_log_prob
    return reward + discount * jnp.where(terminated, 0.0, value)


def critic_targets(
    critic: Critic,
    next_predictions: Prediction,
    batch: Batch,
    next_log_prob: jax.Array,
    temperature: jax.Array,
    discount: float,
    pessimism: float,
) -> Any:
    """Returns the target of each item, each leaf [n, …].

    Args:
      critic: what a prediction means.
      next_predictions: the target critics', of the next action, each leaf [critics, n, …].
      batch: the transitions.
      next_log_prob: the next action's log-density, [n].
      temperature: α, [n] or shared.
      discount: γ.
      pessimism: as `aggregate_q`'s.
    """

    def one(predictions, reward, terminated, log_prob, temperature):
        return critic.target(
            predictions,
            pessimism,
            lambda value: td_target(value, reward, terminated, log_prob, temperature, discount),
        )

    axes = (1, 0, 0, 0, 0 if jnp.ndim(temperature) else None)
    return jax.vmap(one, axes)(next_predictions, batch.reward, batch.terminated, next_log_prob, temperature)


def critic_losses(critic: Critic, predictions: Prediction, target: Any) -> jax.Array:
    """Returns each prediction's loss against its item's target, [critics, n]."""
    return jax.vmap(jax.vmap(critic.loss), in_axes=(0, None))(predictions, target)


def critic_loss(losses: jax.Array) -> jax.Array:
    """Returns J_Q (equation 4): losses [critics, n] averaged over the batch, summed over the independent critics."""
    return jnp.sum(jnp.mean(losses, axis=-1))


def actor_loss(value: jax.Array, log_prob: jax.Array, temperature: jax.Array) -> jax.Array:
    """Returns J_π (equation 3): the mean of α log π − Q, Q aggregated over critics; all [n]."""
    return jnp.mean(temperature * log_prob - value)


def temperature_loss(log_temperature: jax.Array, log_prob: jax.Array, target_entropy: float) -> jax.Array:
    """Returns J(α) (equation 2): the mean of −log α (log π + H̄); the logarithm keeps α positive."""
    return jnp.mean(-log_temperature * (log_prob + target_entropy))
