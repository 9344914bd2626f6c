"""Recurrent EAR: the state encoder and the action decoder each start with an RNN layer."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp

from ear_jax.agents import Agent
from ear_jax.agents.critic import seen_as
from ear_jax.agents.networks import Params, mlp, recurrent_layer, unit_vector
from ear_jax.agents.tanh_gaussian import Gaussian, gaussian
from ear_jax.config import Config, flag
from ear_jax.errors import UsageError
from ear_jax.methods.ear import GATHERED, ear
from ear_jax.methods.method import OF_META_LEARNING, Method, Sizes


def ear_rnn(sizes: Sizes, config: Config) -> Agent:
    """Builds EAR-SAC with RNN layers (paper, appendix B); task encoder and critics are EAR's.

    At every step the policy reads the last `network.history` observations from a hidden state of zeros. All but the
    last are burn-in, and gradients pass through them too. No hidden state is stored, so none can be out of date.
    Critics see the last observation. The RNN layers count in `encoder_layers` and `decoder_layers`.
    """
    network = config.network
    size, width = sizes.obs // network.history, network.width
    plain = ear(dataclasses.replace(sizes, obs=size), config)
    assert plain.critic
    layers = {
        "encoder_rnn": recurrent_layer(size, width, network.initialiser),
        "encoder": mlp(width, (width,) * (network.encoder_layers - 1), network.lse_size, network),
        "decoder_rnn": recurrent_layer(network.lse_size + network.lte_size, width, network.initialiser),
        "decoder": mlp(width, (width,) * (network.decoder_layers - 1), 2 * sizes.action, network),
    }
    on_lse_sphere = unit_vector if network.normalise_lse else lambda lse: lse

    def init_policy(key: jax.Array) -> Params:
        keys = jax.random.split(key, len(layers) + 1)
        own = {name: layer.init(key) for (name, layer), key in zip(layers.items(), keys[1:], strict=True)}
        return {"task_encoder": plain.init_policy(keys[0])["task_encoder"], **own}

    def apply(policy: Params, name: str, x: jax.Array) -> jax.Array:
        return layers[name].apply(policy[name], x)

    def embed_all(policy: Params, obs: jax.Array) -> jax.Array:
        """Returns the LSEs [history, lse]."""
        hidden = apply(policy, "encoder_rnn", obs.reshape(network.history, size))
        return jax.vmap(lambda state: on_lse_sphere(apply(policy, "encoder", state)))(hidden)

    def distribution(policy: Params, code: jax.Array, obs: jax.Array) -> Gaussian:
        inputs = jax.vmap(lambda lse: jnp.concatenate([lse, code]))(embed_all(policy, obs))
        return gaussian(apply(policy, "decoder", apply(policy, "decoder_rnn", inputs)[-1]))

    return dataclasses.replace(
        plain,
        init_policy=init_policy,
        distribution=distribution,
        forecast=None,
        embed=lambda policy, obs: embed_all(policy, obs)[-1],
        critic=seen_as(plain.critic, lambda obs, action, task: (obs[-size:], action, task)),
    )


def check(config: Config) -> None:
    """Raises UsageError for an encoder or decoder without layers, whose first would be the RNN."""
    for name in ("encoder_layers", "decoder_layers"):
        if getattr(config.network, name) < 1:
            raise UsageError(f"{flag(f'network.{name}')} 0 is too small for ear-rnn, whose first layer is its RNN")


_HISTORY = {"network": {"history": 8}}
METHOD = Method(
    "ear-rnn",
    ear_rnn,
    unread=(*OF_META_LEARNING, "sac.outcome_weight"),
    presets={
        "paper": _HISTORY,
        # An update takes 4.5 times as long as EAR's; an hour of one core allows no more epochs.
        "fast": {**_HISTORY, "epochs": 110, "sac": {"lr_decay": 44_000}},
        "smoke": _HISTORY,
        "equivariant": GATHERED,
    },
    check=check,
)
