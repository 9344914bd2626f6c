"""OHE-SAC: a policy of the observation and the task's one-hot, without embeddings."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from ear_jax.agents import Agent
from ear_jax.agents.critic import task_critic
from ear_jax.agents.networks import Params, mlp, unit_vector
from ear_jax.agents.tanh_gaussian import Gaussian, gaussian
from ear_jax.config import Config
from ear_jax.methods.method import OF_A_TASK_ENCODER, OF_EMBEDDINGS, OF_META_LEARNING, Method, Sizes

UNREAD = (*OF_META_LEARNING, *OF_EMBEDDINGS, *OF_A_TASK_ENCODER)


def onehot(sizes: Sizes, config: Config) -> Agent:
    """Builds OHE-SAC (paper, section 4.1), whose codes are one-hots.

    Other codes are unit vectors, as in the search of the authors' code
    (piao-0429/ear_tmp, starter/adaptation/adapt_vel_mt.py).
    """
    network = config.network
    actor = mlp(sizes.obs + sizes.tasks, (network.width,) * network.decoder_layers, 2 * sizes.action, network)

    def distribution(policy: Params, code: jax.Array, obs: jax.Array) -> Gaussian:
        return gaussian(actor.apply(policy, jnp.concatenate([obs, code])))

    return Agent(
        code_size=sizes.tasks,
        init_policy=actor.init,
        codes=lambda policy: jnp.eye(sizes.tasks),
        project=unit_vector,
        distribution=distribution,
        critic=task_critic(sizes.obs, sizes.action, sizes.tasks, config),
        on_sphere=True,
        one_hot=True,
    )


METHOD = Method("onehot", onehot, unread=UNREAD)
