"""The value of a state to an on-policy learner: the return that is still to come in the episode."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from ear_jax.agents.networks import Network, Params, mlp
from ear_jax.config import NetworkConfig

WIDTH = 128
MAX_OBS = 10.0  # standardised observations are clipped to ± this


@dataclass(frozen=True)
class Value:
    """A network of (standardised observation, task, time) that predicts the mean of the rewards to come."""

    tasks: int
    steps: int  # of an episode
    discount: float
    network: Network

    def init(self, key: jax.Array) -> Params:
        """Returns its parameters."""
        return self.network.init(key)

    def __call__(self, params: Params, obs: jax.Array, task: jax.Array, time: jax.Array) -> jax.Array:
        """Returns the value, a scalar.

        Args:
          params: of the network.
          obs: the standardised observation, [obs].
          task: int32, the task's index.
          time: int32, steps since the episode began.
        """
        left = 1 - time / self.steps
        inputs = (jnp.clip(obs, -MAX_OBS, MAX_OBS), jax.nn.one_hot(task, self.tasks), left[None], left[None] ** 2)
        return self.horizon(time) * self.network.apply(params, jnp.concatenate(inputs))[0]

    def horizon(self, time: jax.Array) -> jax.Array:
        """Returns the sum of the discounts of the steps that are left, which is the value of one point a step."""
        left = self.steps - time
        return jnp.asarray(left, jnp.float32) if self.discount == 1 else (1 - self.discount**left) / (1 - self.discount)


def make_value(obs: int, tasks: int, steps: int, discount: float) -> Value:
    """Builds the value function for observations of a size, and for episodes of a number of steps."""
    config = NetworkConfig(initialiser="fan_in")
    return Value(tasks, steps, discount, mlp(obs + tasks + 2, (WIDTH, WIDTH), 1, config, activation=jax.nn.elu))
