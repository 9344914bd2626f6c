"""Critics: what they see, what they predict, and how a prediction is trained. The one place to replace them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp

from ear_jax.agents.networks import Network, Params, mlp
from ear_jax.config import NetworkConfig

Prediction = Any  # one critic's, for one item: here Q itself, a scalar; of a categorical critic its logits [bins]
Bellman = Callable[[jax.Array], jax.Array]  # a value of the next state, of any shape → r + γ (value − α log π)


def aggregate_q(values: jax.Array, pessimism: float) -> jax.Array:
    """Aggregates Q over critics, [critics] → scalar: the minimum at 1 (SAC), the mean at 0, linear between.

    Nauman et al. (2024, arXiv 2405.16158) recommend the mean where critics are regularised otherwise.
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

    By default a prediction is Q. A critic that predicts a distribution brings its own `value`, `target` and `loss`.
    """

    init: Callable[[jax.Array], Params]
    predict: Callable[[Params, jax.Array, jax.Array, jax.Array], Prediction]  # parameters, obs, action, task
    value: Callable[[Prediction], jax.Array] = lambda prediction: prediction  # a prediction → Q, a scalar
    target: Callable[[Prediction, float, Bellman], Any] = scalar_target  # next predictions [critics, …] → target
    loss: Callable[[Prediction, Any], jax.Array] = squared_error  # a prediction and its target → scalar


def critic_network(inputs: int, outputs: int, config: NetworkConfig) -> Network:
    """Builds the body of every critic: ReLU layers, with LayerNorm where `config.critic_layer_norm` says so."""
    widths = (config.width,) * config.critic_layers
    return mlp(inputs, widths, outputs, config, config.critic_layer_norm)


def task_critic(obs_size: int, action_size: int, task_size: int, config: NetworkConfig) -> Critic:
    """Builds a critic that sees observation, action and task, the task as its one-hot or its code."""
    network = critic_network(obs_size + action_size + task_size, 1, config)

    def predict(params: Params, obs: jax.Array, action: jax.Array, task: jax.Array) -> jax.Array:
        return network.apply(params, jnp.concatenate([obs, action, task]))[0]

    return Critic(network.init, predict)
