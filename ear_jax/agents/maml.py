"""MAML: parameters from which one policy gradient leads to a task's own."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

from ear_jax.agents.agent import Agent
from ear_jax.config import NetworkConfig
from ear_jax.networks import Params, mlp
from ear_jax.policy import LOG_STD_RANGE, Gaussian


def maml(obs_size: int, action_size: int, tasks: int, config: NetworkConfig, lte_noise: float) -> Agent:
    """The policy of MAML (Finn et al. 2017, arXiv 1703.03400): tanh layers, and a spread that no observation moves.

    A task's code is how far its parameters lie from those that all tasks begin with, so that tuning a policy to a task
    is one more way to a new code, and all else that uses a policy knows nothing of it. There are no critics.

    Args:
      obs_size, action_size, tasks: sizes.
      config: `width` and `decoder_layers` are the policy's. It multiplies float32: the curvature that an update follows
        takes a derivative forwards, and the bfloat16 product has none.
      lte_noise: has no use here.
    """
    widths = (config.width,) * config.decoder_layers
    network = mlp(obs_size, widths, action_size, replace(config, matmul="float32"), activation=jnp.tanh)

    def init_policy(key: jax.Array) -> Params:
        return {"network": network.init(key), "log_std": jnp.zeros(action_size)}

    shapes = jax.eval_shape(init_policy, jax.random.key(0))
    flat, rebuild = ravel_pytree(jax.tree.map(lambda leaf: jnp.zeros(leaf.shape), shapes))

    def distribution(policy: Params, code: jax.Array, obs: jax.Array) -> Gaussian:
        own = jax.tree.map(jnp.add, policy, rebuild(code))
        return Gaussian(network.apply(own["network"], obs), jnp.clip(own["log_std"], *LOG_STD_RANGE))

    return Agent(
        code_size=len(flat),
        init_policy=init_policy,
        init_critic=lambda key: {},
        codes=lambda policy: jnp.zeros((tasks, len(flat))),
        project=lambda code: code,
        code_noise=0.0,
        distribution=distribution,
        value=lambda params, obs, action, task: jnp.zeros(()),
        tuned=True,
    )
