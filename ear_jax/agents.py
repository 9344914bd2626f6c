"""Agents: what a method is, told by pure functions of parameters. The trainer and everything after it see only this."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp

from ear_jax.config import NetworkConfig
from ear_jax.errors import unknown
from ear_jax.networks import Params, identity, mlp, unit
from ear_jax.policy import Gaussian, gaussian


@dataclass(frozen=True)
class Agent:
    """A method as functions; obs is [obs], action [act], code [code], task a one-hot [tasks], all of one item.

    A critic's obs comes standardised; the policy standardises for itself, with what is among its parameters.

    A code is a row of the code table, and the policy knows a task by nothing else: interpolation, composition and
    search only make new rows.
    """

    code_size: int
    init_policy: Callable[[jax.Array], Params]  # a dictionary; its "standardiser" is applied to what all networks see
    init_critic: Callable[[jax.Array], Params]
    codes: Callable[[Params], jax.Array]  # policy parameters → table [tasks, code]
    project: Callable[[jax.Array], jax.Array]  # any vector [code] → the code nearest to it, as the unit sphere's
    code_noise: float  # σ of the noise on a code in the actor's objectives, before it is projected again
    distribution: Callable[[Params, jax.Array, jax.Array], Gaussian]  # policy parameters, code, obs
    embed: Callable[[Params, jax.Array], jax.Array] | None  # policy parameters, obs → LSE, where there is one
    value: Callable[[Params, jax.Array, jax.Array, jax.Array], jax.Array]  # a critic's parameters, obs, action, task


def ear(obs_size: int, action_size: int, tasks: int, config: NetworkConfig, lte_noise: float) -> Agent:
    """EAR-SAC (paper, section 3.1): ψ(φ(s), LTE), both embeddings on unit spheres, and critics that see the one-hot.

    Args:
      obs_size, action_size, tasks: sizes.
      config: widths and depths.
      lte_noise: σ of the noise added to an LTE, before it is normalised again (algorithm 1).
    """
    widths = (config.width,)
    encoder = mlp(obs_size, widths * config.encoder_layers, config.lse_size, config.initialiser)
    task_encoder = mlp(tasks, widths * config.task_layers, config.lte_size, config.initialiser)
    decoder = mlp(
        config.lse_size + config.lte_size, widths * config.decoder_layers, 2 * action_size, config.initialiser
    )
    critic = mlp(
        obs_size + action_size + tasks,
        widths * config.critic_layers,
        1,
        config.initialiser,
        config.critic_layer_norm,
    )
    on_lse_sphere = unit if config.normalise_lse else lambda lse: lse
    on_lte_sphere = unit if config.normalise_lte else lambda lte: lte

    def init_policy(key: jax.Array) -> Params:
        key_encoder, key_task, key_decoder = jax.random.split(key, 3)
        return {
            "standardiser": identity(obs_size),
            "encoder": encoder.init(key_encoder),
            "task_encoder": task_encoder.init(key_task),
            "decoder": decoder.init(key_decoder),
        }

    def codes(policy: Params) -> jax.Array:
        return jax.vmap(lambda task: on_lte_sphere(task_encoder.apply(policy["task_encoder"], task)))(jnp.eye(tasks))

    def embed(policy: Params, obs: jax.Array) -> jax.Array:
        return on_lse_sphere(encoder.apply(policy["encoder"], policy["standardiser"](obs)))

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
        embed=embed,
        value=value,
    )


AGENTS = {"ear": ear}


def make_agent(
    name: str, obs_size: int, action_size: int, tasks: int, config: NetworkConfig, lte_noise: float
) -> Agent:
    """An agent by name; raises UsageError where there is none."""
    if name not in AGENTS:
        raise unknown("agent", name, AGENTS)
    return AGENTS[name](obs_size, action_size, tasks, config, lte_noise)
