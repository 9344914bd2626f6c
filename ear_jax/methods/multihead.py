"""MHMT-SAC: one body, with a head and a temperature for each task."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from ear_jax.agents import Agent
from ear_jax.agents.critic import critic_network, make_critic
from ear_jax.agents.networks import Params, mlp
from ear_jax.agents.tanh_gaussian import Gaussian, gaussian
from ear_jax.config import Config
from ear_jax.methods.method import OF_A_TASK_ENCODER, OF_EMBEDDINGS, OF_META_LEARNING, Method, Sizes


def multihead(sizes: Sizes, config: Config) -> Agent:
    """Builds MHMT-SAC (paper, section 4.1): a task's code is its one-hot, which selects a head of the policy.

    Heads cannot be blended, so any other code is projected to the one-hot of its largest number. The heads together are
    the last layer of one network; those not selected get no gradient. `decoder_layers` and `critic_layers` are the
    depths without the heads.
    """
    network, tasks = config.network, sizes.tasks
    actor = mlp(sizes.obs, (network.width,) * network.decoder_layers, tasks * 2 * sizes.action, network)
    bins = network.critic_bins
    critics = critic_network(sizes.obs + sizes.action, tasks * (bins or 1), network)

    def distribution(policy: Params, code: jax.Array, obs: jax.Array) -> Gaussian:
        heads = actor.apply(policy, obs).reshape(tasks, 2 * sizes.action)
        return gaussian(jnp.sum(code[:, None] * heads, axis=0))

    def select(heads: jax.Array, task: jax.Array) -> jax.Array:
        return task @ heads.reshape(tasks, bins) if bins else jnp.sum(task * heads)

    return Agent(
        code_size=tasks,
        init_policy=actor.init,
        codes=lambda policy: jnp.eye(tasks),
        project=lambda code: jax.nn.one_hot(jnp.argmax(code), tasks),
        distribution=distribution,
        critic=make_critic(critics, config, lambda obs, action, task: jnp.concatenate([obs, action]), select),
        own_temperatures=True,
        one_hot=True,
    )


METHOD = Method(
    "multihead",
    multihead,
    unread=(*OF_META_LEARNING, *OF_EMBEDDINGS, *OF_A_TASK_ENCODER),
    presets={"paper": {"network": {"decoder_layers": 3, "critic_layers": 3}, "sac": {"max_grad_norm": 1.0}}},
    # With the mean of the critics, which the family has for EAR, they overestimate: seed 0 returns 81 instead of 149.
    families={"fast": {"hopper-vel": {"sac": {"pessimism": 1.0}}}},
)
