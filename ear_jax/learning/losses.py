"""The SAC objectives as functions of a batch [n]: differentiated parameters come first, then data, then noise.

Equation numbers are the paper's (appendix A). Functions of one item are vmapped here.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ear_jax.agents import Agent
from ear_jax.agents.critic import Critic, Prediction
from ear_jax.agents.networks import BATCH, Params
from ear_jax.agents.tanh_gaussian import sample
from ear_jax.learning.batch import Batch, Noise, rows_of_items


def sample_policy(
    policy: Params, agent: Agent, table: jax.Array, obs: jax.Array, task: jax.Array, noise: Noise
) -> tuple[jax.Array, jax.Array]:
    """Samples actions [n, act] and log-densities [n], each under its task's code plus noise (algorithm 1)."""

    def one(obs, row, noise):
        code = agent.project(row + agent.code_noise * noise.code)
        return sample(agent.distribution(policy, code, obs), noise.action)

    return jax.vmap(one)(obs, rows_of_items(table, task), noise)


def predictions(critics: Params, critic: Critic, obs: jax.Array, action: jax.Array, task: jax.Array) -> Prediction:
    """Returns every critic's prediction, each leaf [critics, n, …]; `task` [n, ·] is one-hots or codes.

    With critics as the outer axis each layer is one batched matmul, and none needs a transposition.
    """
    of_batch = jax.vmap(critic.predict, in_axes=(None, 0, 0, 0))
    return jax.vmap(of_batch, in_axes=(0, None, None, None))(critics, obs, action, task)


class Acts(NamedTuple):
    """Observations and actions that critics judge in a batch."""

    obs: jax.Array  # [n, obs], standardised
    action: jax.Array  # [n, act]


def training_predictions(
    critics: Params, critic: Critic, now: Acts, later: Acts, task: jax.Array
) -> tuple[Prediction, Params]:
    """Returns every critic's predictions for a batch's acts, and new running statistics, empty without BatchNorm."""
    if critic.predict_in_batch is None:
        return predictions(critics, critic, *now, task), {}
    predicted, _, statistics = as_one_batch(critics, critic, now, later, task)
    return predicted, statistics


def target_predictions(critics: Params, critic: Critic, now: Acts, later: Acts, task: jax.Array) -> Prediction:
    """Returns every target critic's predictions for the acts of the next step, each leaf [critics, n, …]."""
    if critic.predict_in_batch is None:
        return predictions(critics, critic, *later, task)
    return as_one_batch(critics, critic, now, later, task)[1]


def as_one_batch(
    critics: Params, critic: Critic, now: Acts, later: Acts, task: jax.Array
) -> tuple[Prediction, Prediction, Params]:
    """Returns the predictions of critics with BatchNorm for the acts of a step and of the next one, and statistics.

    Both are one batch, so that predictions and targets are normalised alike (Bhatt et al. 2019, arXiv 1902.05605).
    """
    assert critic.predict_in_batch
    inputs = jax.tree.map(lambda *halves: jnp.concatenate(halves), (*now, task), (*later, task))
    of_batch = jax.vmap(critic.predict_in_batch, in_axes=(None, 0, 0, 0), out_axes=(0, None), axis_name=BATCH)
    predicted, statistics = jax.vmap(of_batch, in_axes=(0, None, None, None))(critics, *inputs)
    halves = jax.tree.map(lambda leaf: jnp.split(leaf, 2, axis=1), predicted)
    first, second = jax.tree.transpose(jax.tree.structure(predicted), jax.tree.structure([0, 0]), halves)
    return first, second, statistics


def q_values(critic: Critic, predictions: Prediction) -> jax.Array:
    """Returns Q [critics, n] from predictions [critics, n, …]."""
    return jax.vmap(jax.vmap(critic.value))(predictions)


def td_target(
    next_value: jax.Array,
    reward: jax.Array,
    terminated: jax.Array,
    next_log_prob: jax.Array,
    temperature: jax.Array,
    discount: float,
) -> jax.Array:
    """Returns r + γ V̄(s′) with V̄ = Q̄ − α log π (equation 5), or r after a termination.

    A time limit is not a termination. For one item: `next_value` has any shape, the other arguments are scalars.
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
      critic: interprets predictions.
      next_predictions: the target critics' predictions for the next action, each leaf [critics, n, …].
      batch: the transitions.
      next_log_prob: the next action's log-density, [n].
      temperature: α, [n] or a scalar.
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
    """Returns J_Q (equation 4): losses [critics, n] averaged over the batch and summed over the critics."""
    return jnp.sum(jnp.mean(losses, axis=-1))


def actor_loss(value: jax.Array, log_prob: jax.Array, temperature: jax.Array) -> jax.Array:
    """Returns J_π (equation 3), the mean of α log π − Q; Q is aggregated over critics, and all are [n]."""
    return jnp.mean(temperature * log_prob - value)


def temperature_loss(log_temperature: jax.Array, log_prob: jax.Array, target_entropy: float) -> jax.Array:
    """Returns J(α) (equation 2), the mean of −log α (log π + H̄); learning log α keeps α positive."""
    return jnp.mean(-log_temperature * (log_prob + target_entropy))


def outcome_loss(policy: Params, agent: Agent, batch: Batch) -> jax.Array:
    """Returns the error by which φ learns to predict, over one step: of the next LSE, plus the mean over outcomes.

    Outcomes are in units of their spread in the batch (Fujimoto et al. 2025, arXiv 2501.16142, with outcomes, which
    all tasks share, in place of the reward).
    """
    assert agent.forecast
    assert agent.embed
    lse, outcomes = jax.vmap(agent.forecast, in_axes=(None, 0, 0))(policy, batch.obs, batch.action)
    next_lse = jax.lax.stop_gradient(jax.vmap(agent.embed, in_axes=(None, 0))(policy, batch.next_obs))
    actual = jnp.stack([batch.outcome[name] for name in sorted(batch.outcome)], axis=1)
    actual = (actual - jnp.mean(actual, axis=0)) / (jnp.std(actual, axis=0) + 1e-6)
    return jnp.mean(jnp.sum((lse - next_lse) ** 2, axis=1)) + jnp.mean((outcomes - actual) ** 2)
