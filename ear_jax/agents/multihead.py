"""MHMT-SAC: one body, and for every task a head and a temperature of its own."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from ear_jax.agents.agent import Agent, critic_network
from ear_jax.config import NetworkConfig
from ear_jax.networks import Params, mlp
from ear_jax.policy import Gaussian, gaussian


def multihead(obs_size: int, action_size: int, tasks: int, config: NetworkConfig, lte_noise: float) -> Agent:
    """MHMT-SAC (paper, section 4.1): a task's code is its one-hot, and picks a head of the policy.

    There is nothing between two heads, so every other code is taken to the one-hot of its largest number. The heads
    are the last layer of one network, side by side: a head that is not picked gets no gradient.

    Args:
      obs_size, action_size, tasks: sizes.
      config: widths, and the depths of decoder and critics without their heads.
      lte_noise: has no use here: there is no LTE.
    """
    actor = mlp(obs_size, (config.width,) * config.decoder_layers, tasks * 2 * action_size, config)
    critic = critic_network(obs_size + action_size, tasks, config)

    def distribution(policy: Params, code: jax.Array, obs: jax.Array) -> Gaussian:
        heads = actor.apply(policy, obs).reshape(tasks, 2 * action_size)
        return gaussian(jnp.sum(code[:, None] * heads, axis=0))

    def value(params: Params, obs: jax.Array, action: jax.Array, task: jax.Array) -> jax.Array:
        return jnp.sum(task * critic.apply(params, jnp.concatenate([obs, action])))

    return Agent(
        code_size=tasks,
        init_policy=actor.init,
        init_critic=critic.init,
        codes=lambda policy: jnp.eye(tasks),
        project=lambda code: jax.nn.one_hot(jnp.argmax(code), tasks),
        code_noise=0.0,
        distribution=distribution,
        value=value,
        own_temperatures=True,
    )
