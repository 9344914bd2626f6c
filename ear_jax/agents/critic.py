"""Critics: their inputs, predictions, targets and losses. Only this file has to change for another kind of critic."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from ear_jax.agents import categorical
from ear_jax.agents.networks import Network, Params, mlp, residual
from ear_jax.config import Config, NetworkConfig, is_on

Prediction = Any  # of one critic for one item: here Q, a scalar; for a categorical critic its logits [bins]
Bellman = Callable[[jax.Array], jax.Array]  # next state's Q, of any shape → r + γ (Q − α log π)


def aggregate_q(values: jax.Array, pessimism: float) -> jax.Array:
    """Aggregates Q over critics, [critics] → scalar: the minimum at 1 (SAC), the mean at 0, linear between.

    Nauman et al. (2024, arXiv 2405.16158) recommend the mean for critics with other regularisation.
    """
    return pessimism * jnp.min(values, axis=0) + (1 - pessimism) * jnp.mean(values, axis=0)


def scalar_target(next_predictions: jax.Array, pessimism: float, bellman: Bellman) -> jax.Array:
    """Returns the target of critics that predict Q, from the target critics' next predictions [critics]."""
    return bellman(aggregate_q(next_predictions, pessimism))


def clipped_target(next_predictions: jax.Array, pessimism: float, bellman: Bellman, limit: float) -> jax.Array:
    """Returns `scalar_target` within ± `limit`."""
    return jnp.clip(scalar_target(next_predictions, pessimism, bellman), -limit, limit)


def squared_error(prediction: jax.Array, target: jax.Array) -> jax.Array:
    """Returns ½ (Q − target)² (equation 4)."""
    return 0.5 * (prediction - target) ** 2


@dataclass(frozen=True)
class Critic:
    """One critic as functions of one item: obs [obs], action [act], task [tasks] or [code]. Learners train two.

    By default a prediction is Q. A critic that predicts a distribution defines its own `value`, `target` and `loss`.
    """

    init: Callable[[jax.Array], Params]
    predict: Callable[[Params, jax.Array, jax.Array, jax.Array], Prediction]  # parameters, obs, action, task
    value: Callable[[Prediction], jax.Array] = lambda prediction: prediction  # a prediction → Q, a scalar
    target: Callable[[Prediction, float, Bellman], Any] = scalar_target  # next predictions [critics, …] → target
    loss: Callable[[Prediction, Any], jax.Array] = squared_error  # a prediction and its target → scalar


def critic_network(inputs: int, outputs: int, config: NetworkConfig) -> Network:
    """Builds the network that all critics use: residual blocks, or ReLU layers with LayerNorm if that is set."""
    if config.critic_blocks:
        return residual(inputs, config.critic_blocks, outputs, config)
    widths = (config.width,) * config.critic_layers
    return mlp(inputs, widths, outputs, config, config.critic_layer_norm)


def make_critic(init: Callable[..., Params], predict: Callable[..., Prediction], config: Config) -> Critic:
    """Builds a critic trained as the settings say.

    Args:
      init: key → parameters.
      predict: (parameters, obs, action, task) → Q, or its logits [bins] if `network.critic_bins` is set.
      config: the settings.
    """
    limit = config.sac.return_scale
    if config.network.critic_bins:
        value, target = (partial(function, limit=limit) for function in (categorical.value, categorical.target))
        return Critic(init, predict, value, target, categorical.loss)
    return Critic(init, predict, target=partial(clipped_target, limit=limit) if is_on(limit) else scalar_target)


def task_critic(obs_size: int, action_size: int, task_size: int, config: Config) -> Critic:
    """Builds a critic of observation, action and task, where the task is a one-hot, a code or both."""
    bins = config.network.critic_bins
    network = critic_network(obs_size + action_size + task_size, bins or 1, config.network)

    def predict(params: Params, obs: jax.Array, action: jax.Array, task: jax.Array) -> Prediction:
        output = network.apply(params, jnp.concatenate([obs, action, task]))
        return output if bins else output[0]

    return make_critic(network.init, predict, config)
