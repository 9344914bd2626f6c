"""Recurrent EAR: the first layer of the state encoder and of the action decoder is an RNN layer."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp

from ear_jax.agents.agent import Agent
from ear_jax.agents.ear import ear
from ear_jax.config import NetworkConfig
from ear_jax.networks import Params, mlp, recurrent_layer, unit
from ear_jax.policy import Gaussian, gaussian


def ear_rnn(obs_size: int, action_size: int, tasks: int, config: NetworkConfig, lte_noise: float) -> Agent:
    """EAR-SAC with RNN layers (paper, appendix B: comparison of MLP and RNN); task encoder and critics are EAR's.

    The policy reads the last `config.history` observations anew at every step, from a state of zeros: all but the last
    are its burn-in, through which gradients pass too. So nothing it acts by is ever older than its parameters, and
    replay needs no states. Critics see the last observation.

    Args:
      obs_size: of `config.history` observations, the oldest first.
      action_size, tasks: sizes.
      config: widths and depths; the RNN layer is the first of `encoder_layers` and `decoder_layers`.
      lte_noise: as `ear`'s.
    """
    size, width = obs_size // config.history, config.width
    plain = ear(size, action_size, tasks, config, lte_noise)
    codes_size = config.lse_size + config.lte_size
    layers = {
        "encoder_rnn": recurrent_layer(size, width, config.initialiser),
        "encoder": mlp(width, (width,) * (config.encoder_layers - 1), config.lse_size, config),
        "decoder_rnn": recurrent_layer(codes_size, width, config.initialiser),
        "decoder": mlp(width, (width,) * (config.decoder_layers - 1), 2 * action_size, config),
    }
    on_lse_sphere = unit if config.normalise_lse else lambda lse: lse

    def init_policy(key: jax.Array) -> Params:
        keys = jax.random.split(key, len(layers) + 1)
        own = {name: layer.init(key) for (name, layer), key in zip(layers.items(), keys[1:], strict=True)}
        return {"task_encoder": plain.init_policy(keys[0])["task_encoder"], **own}

    def apply(policy: Params, name: str, x: jax.Array) -> jax.Array:
        return layers[name].apply(policy[name], x)

    def embed_all(policy: Params, obs: jax.Array) -> jax.Array:
        """LSEs [history, lse]."""
        hidden = apply(policy, "encoder_rnn", obs.reshape(config.history, size))
        return jax.vmap(lambda one: on_lse_sphere(apply(policy, "encoder", one)))(hidden)

    def distribution(policy: Params, code: jax.Array, obs: jax.Array) -> Gaussian:
        seen = jax.vmap(lambda lse: jnp.concatenate([lse, code]))(embed_all(policy, obs))
        return gaussian(apply(policy, "decoder", apply(policy, "decoder_rnn", seen)[-1]))

    def value(params: Params, obs: jax.Array, action: jax.Array, task: jax.Array) -> jax.Array:
        return plain.value(params, obs[-size:], action, task)

    return dataclasses.replace(
        plain,
        init_policy=init_policy,
        distribution=distribution,
        embed=lambda policy, obs: embed_all(policy, obs)[-1],
        value=value,
    )
