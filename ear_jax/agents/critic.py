"""Critics: their inputs, predictions, targets and losses. Only this file has to change for another kind of critic."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp

from ear_jax.agents.networks import Network, Params, mlp
from ear_jax.config import NetworkConfig

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
    """Builds the network that all critics use: ReLU layers, with LayerNorm if `config.critic_layer_norm` is set."""
    widths = (config.width,) * config.critic_layers
    return mlp(inputs, widths, outputs, config, config.critic_layer_norm)


def task_critic(obs_size: int, action_size: int, task_size: int, config: NetworkConfig) -> Critic:
    """Builds a critic of observation, action and task, where the task is a one-hot or a code."""
    network = critic_network(obs_size + action_size + task_size, 1, config)

    def predict(params: Params, obs: jax.Array, action: jax.Array, task: jax.Array) -> jax.Array:
        return network.apply(params, jnp.concatenate([obs, action, task]))[0]

    return Critic(network.init, predict)
