"""EAR-SAC: one policy under a learnt embedding of the task."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from ear_jax.agents.agent import Agent, critic_network
from ear_jax.config import NetworkConfig
from ear_jax.networks import Params, mlp, unit
from ear_jax.policy import Gaussian, gaussian


def ear(obs_size: int, action_size: int, tasks: int, config: NetworkConfig, lte_noise: float) -> Agent:
    """EAR-SAC (paper, section 3.1): ψ(φ(s), LTE), both embeddings on unit spheres, and critics that see the one-hot.

    Args:
      obs_size, action_size, tasks: sizes.
      config: widths and depths.
      lte_noise: σ of the noise added to an LTE, before it is normalised again (algorithm 1).
    """
    widths = (config.width,)
    encoder = mlp(obs_size, widths * config.encoder_layers, config.lse_size, config)
    gathered = config.lte_start == "gathered"
    task_encoder = mlp(tasks, (config.task_width,) * config.task_layers, config.lte_size, config, gathered=gathered)
    decoder = mlp(config.lse_size + config.lte_size, widths * config.decoder_layers, 2 * action_size, config)
    critic = critic_network(obs_size + action_size + tasks, 1, config)
    on_lse_sphere = unit if config.normalise_lse else lambda lse: lse
    on_lte_sphere = unit if config.normalise_lte else lambda lte: lte

    def init_policy(key: jax.Array) -> Params:
        key_encoder, key_task, key_decoder = jax.random.split(key, 3)
        return {
            "encoder": encoder.init(key_encoder),
            "task_encoder": task_encoder.init(key_task),
            "decoder": decoder.init(key_decoder),
        }

    def codes(policy: Params) -> jax.Array:
        return jax.vmap(lambda task: on_lte_sphere(task_encoder.apply(policy["task_encoder"], task)))(jnp.eye(tasks))

    def embed(policy: Params, obs: jax.Array) -> jax.Array:
        return on_lse_sphere(encoder.apply(policy["encoder"], obs))

    def distribution(policy: Params, code: jax.Array, obs: jax.Array) -> Gaussian:
        return gaussian(decoder.apply(policy["decoder"], jnp.concatenate([embed(policy, obs), code])))

    def value(params: Params, obs: jax.Array, action: jax.Array, task: jax.Array) -> jax.Array:
        return critic.apply(params, jnp.concatenate([obs, action, task]))[0]

    return Agent(
        code_size=config.lte_size,
        init_policy=init_policy,
        init_critic=critic.init,
        codes=codes,
        project=on_lte_sphere,
        code_noise=lte_noise,
        distribution=distribution,
        on_sphere=config.normalise_lte,
        embed=embed,
        value=value,
    )
