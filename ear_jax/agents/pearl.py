"""PEARL: the task's code is inferred from what happened in it."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from ear_jax.agents.agent import Agent, critic_network
from ear_jax.belief import Belief, Context, product
from ear_jax.config import NetworkConfig
from ear_jax.networks import Params, mlp
from ear_jax.policy import Gaussian, gaussian

MIN_VARIANCE = 1e-7  # of what a single step tells


def pearl(obs_size: int, action_size: int, tasks: int, config: NetworkConfig, lte_noise: float) -> Agent:
    """PEARL (Rakelly et al. 2019, arXiv 1903.08254; katerakelly/oyster) on this trainer.

    An encoder of single steps (s, a, r) gives each step's belief about the code, and their product is the task's.
    Critics see a drawn code in place of the one-hot, and their loss trains the encoder; the policy sees it without a
    gradient. The original has a state value and a fixed temperature; here critics and temperature are every agent's.

    Args:
      obs_size, action_size, tasks: sizes.
      config: widths and depths; `task_width` and `task_layers` are the encoder's, `lte_size` is the code's.
      lte_noise: has no use here: codes are drawn from a belief.
    """
    size = config.lte_size
    encoder = mlp(obs_size + action_size + 1, (config.task_width,) * config.task_layers, 2 * size, config)
    actor = mlp(obs_size + size, (config.width,) * config.decoder_layers, 2 * action_size, config)
    critic = critic_network(obs_size + action_size + size, 1, config)

    def init_policy(key: jax.Array) -> Params:
        key_encoder, key_actor = jax.random.split(key)
        return {"encoder": encoder.init(key_encoder), "actor": actor.init(key_actor)}

    def infer(policy: Params, context: Context) -> Belief:
        steps = jnp.concatenate([context.obs, context.action, context.reward[:, None]], axis=1)
        mean, spread = jnp.split(jax.vmap(lambda step: encoder.apply(policy["encoder"], step))(steps), 2, axis=1)
        return product(mean, jnp.maximum(jax.nn.softplus(spread), MIN_VARIANCE), context.valid)

    def distribution(policy: Params, code: jax.Array, obs: jax.Array) -> Gaussian:
        return gaussian(actor.apply(policy["actor"], jnp.concatenate([obs, code])))

    def value(params: Params, obs: jax.Array, action: jax.Array, task: jax.Array) -> jax.Array:
        return critic.apply(params, jnp.concatenate([obs, action, task]))[0]

    return Agent(
        code_size=size,
        init_policy=init_policy,
        init_critic=critic.init,
        codes=lambda policy: jnp.zeros((tasks, size)),
        project=lambda code: code,
        code_noise=0.0,
        distribution=distribution,
        value=value,
        infer=infer,
    )
