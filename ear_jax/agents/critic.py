"""Critics: their inputs, predictions, targets and losses. Only this file has to change for another kind of critic."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from ear_jax.agents import categorical
from ear_jax.agents.networks import Network, Params, batch_normed, mlp, residual, unit_columns
from ear_jax.config import Config, NetworkConfig, is_on
from ear_jax.process.target import on_accelerator

FEW = 32  # tasks up to which a CPU multiplies by a one-hot, which is then as fast as taking a row
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
    """One critic as functions of one item: obs [obs], action [act], task [tasks], [code] or both. Learners train two.

    By default a prediction is Q. A critic that predicts a distribution defines its own `value`, `target` and `loss`.
    """

    init: Callable[[jax.Array], Params]
    predict: Callable[[Params, jax.Array, jax.Array, jax.Array], Prediction]  # parameters, obs, action, task
    value: Callable[[Prediction], jax.Array] = lambda prediction: prediction  # a prediction → Q, a scalar
    target: Callable[[Prediction, float, Bellman], Any] = scalar_target  # next predictions [critics, …] → target
    loss: Callable[[Prediction, Any], jax.Array] = squared_error  # a prediction and its target → scalar
    # As `predict` for an item of a batch that normalises it; also returns the parameters' new `batch_stats`.
    predict_in_batch: Callable[[Params, jax.Array, jax.Array, jax.Array], tuple[Prediction, Params]] | None = None
    constrain: Callable[[Params], Params] = lambda params: params  # applied to the parameters after every step


def critic_network(inputs: int, outputs: int, config: NetworkConfig) -> Network:
    """Builds the network that all critics use: residual blocks, or ReLU layers with BatchNorm or LayerNorm if set."""
    if config.critic_blocks:
        return residual(inputs, config.critic_blocks, outputs, config)
    widths = (config.width,) * config.critic_layers
    if config.critic_batch_norm:
        return batch_normed(inputs, widths, outputs, config)
    return mlp(inputs, widths, outputs, config, config.critic_layer_norm)


def make_critic(
    network: Network,
    config: Config,
    join: Callable[[jax.Array, jax.Array, jax.Array], jax.Array],
    select: Callable[[jax.Array, jax.Array], Prediction],
) -> Critic:
    """Builds a critic trained as the settings say.

    Args:
      network: from `critic_network`.
      config: the settings.
      join: obs, action, task → the network's input.
      select: the network's output, task → Q, or its logits [bins] if `network.critic_bins` is set.
    """
    limit, in_batch = config.sac.return_scale, network.apply_in_batch

    def predict(params: Params, obs: jax.Array, action: jax.Array, task: jax.Array) -> Prediction:
        return select(network.apply(params, join(obs, action, task)), task)

    def predict_in_batch(params: Params, obs: jax.Array, action: jax.Array, task: jax.Array) -> tuple[Any, Params]:
        assert in_batch
        output, statistics = in_batch(params, join(obs, action, task))
        return select(output, task), statistics

    critic = Critic(network.init, predict)
    if in_batch:
        critic = replace(critic, predict_in_batch=predict_in_batch, constrain=unit_columns)
    if config.network.critic_bins:
        value, target = (partial(function, limit=limit) for function in (categorical.value, categorical.target))
        return replace(critic, value=value, target=target, loss=categorical.loss)
    return replace(critic, target=partial(clipped_target, limit=limit)) if is_on(limit) else critic


def task_critic(obs_size: int, action_size: int, task_size: int, config: Config, one_hot: int = 0) -> Critic:
    """Builds a critic of observation, action and task, where the task is a one-hot, a code or both.

    Args:
      obs_size: the size of an observation.
      action_size: the size of an action.
      task_size: the size of what the critic sees of the task.
      config: the settings.
      one_hot: the size of the one-hot at the start of the task, if there is one.
    """
    bins = config.network.critic_bins
    before, inputs = obs_size + action_size, obs_size + action_size + task_size
    network = critic_network(inputs, bins or 1, config.network)
    if one_hot > FEW and not config.network.critic_batch_norm and not on_accelerator():
        rest = critic_network(inputs - one_hot, bins or 1, config.network)
        network = replace(network, apply=with_row(rest, before, one_hot))
    return make_critic(
        network,
        config,
        join=lambda *inputs: jnp.concatenate(inputs),
        select=lambda output, task: output if bins else output[0],
    )


def with_row(rest: Network, start: int, size: int) -> Callable[[Params, jax.Array], jax.Array]:
    """Builds the `apply` of a network whose input holds a one-hot, at a cost that does not grow with the one-hot.

    In the first layer a one-hot selects a row of the weights, which is added to the bias here.

    Args:
      rest: the network without the one-hot.
      start: the place of the one-hot in the input.
      size: its size. Zeros in its place would count as the first task.
    """
    end = start + size

    def apply(params: Params, x: jax.Array) -> jax.Array:
        layers = params["params"]
        kernel, bias = (layers["Dense_0"][name] for name in ("kernel", "bias"))
        first = {
            "kernel": jnp.concatenate([kernel[:start], kernel[end:]]),
            "bias": bias + kernel[start + jnp.argmax(x[start:end])],
        }
        others = jnp.concatenate([x[:start], x[end:]])
        return rest.apply({"params": {**layers, "Dense_0": first}}, others)

    return apply


def seen_as(critic: Critic, change: Callable[[jax.Array, jax.Array, jax.Array], tuple[jax.Array, ...]]) -> Critic:
    """Returns a critic whose inputs obs, action and task are changed first."""
    in_batch = critic.predict_in_batch
    return replace(
        critic,
        predict=lambda params, *inputs: critic.predict(params, *change(*inputs)),
        predict_in_batch=in_batch and (lambda params, *inputs: in_batch(params, *change(*inputs))),
    )
