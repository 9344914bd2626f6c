"""OHE-SAC: the task's one-hot beside the raw observation, no embedding of either; and the same with it zeroed."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from ear_jax.agents.agent import Agent, critic_network
from ear_jax.config import NetworkConfig
from ear_jax.networks import Params, mlp, unit
from ear_jax.policy import Gaussian, gaussian


def onehot(obs_size: int, action_size: int, tasks: int, config: NetworkConfig, lte_noise: float) -> Agent:
    """OHE-SAC (paper, section 4.1): a one-hot is the code.

    Other codes lie on the sphere that one-hots lie on, where the authors' code searches them too
    (piao-0429/ear_tmp, starter/adaptation/adapt_vel_mt.py).

    Args:
      obs_size, action_size, tasks: sizes.
      config: widths, and the depths of decoder and critics.
      lte_noise: has no use here: there is no LTE.
    """
    return _onehot(obs_size, action_size, tasks, config, shown=1.0)


def onehot_blind(obs_size: int, action_size: int, tasks: int, config: NetworkConfig, lte_noise: float) -> Agent:
    """OHE-SAC whose policy and critics see zeros instead of the one-hot: what can be had without knowing the task.

    So the authors' older code trains: its replay holds zeros in the one-hot's place, and the paper's returns of OHE-SAC
    are those of a task-blind policy. Arguments as `onehot`'s.
    """
    return _onehot(obs_size, action_size, tasks, config, shown=0.0)


def _onehot(obs_size: int, action_size: int, tasks: int, config: NetworkConfig, shown: float) -> Agent:
    """`shown`: what every code and one-hot is multiplied by."""
    widths = (config.width,) * config.decoder_layers
    actor = mlp(obs_size + tasks, widths, 2 * action_size, config)
    critic = critic_network(obs_size + action_size + tasks, 1, config)

    def distribution(policy: Params, code: jax.Array, obs: jax.Array) -> Gaussian:
        return gaussian(actor.apply(policy, jnp.concatenate([obs, code])))

    def value(params: Params, obs: jax.Array, action: jax.Array, task: jax.Array) -> jax.Array:
        return critic.apply(params, jnp.concatenate([obs, action, shown * task]))[0]

    return Agent(
        code_size=tasks,
        init_policy=actor.init,
        init_critic=critic.init,
        codes=lambda policy: shown * jnp.eye(tasks),
        project=lambda code: shown * unit(code),
        code_noise=0.0,
        distribution=distribution,
        on_sphere=bool(shown),
        value=value,
    )
