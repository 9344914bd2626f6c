"""The interface of Brax's environments, whose own module takes two seconds to import."""

from __future__ import annotations

import abc
from typing import Any

import jax
from flax import struct


@struct.dataclass
class State:
    """An environment's state, with the fields of `brax.envs.State`."""

    pipeline_state: Any  # of the simulation
    obs: jax.Array  # [obs]
    reward: jax.Array  # scalar
    done: jax.Array  # float scalar, 1 at the end of an episode
    metrics: dict[str, jax.Array]  # scalars by name
    info: dict[str, Any]  # whatever an environment or a wrapper carries along


class Env(abc.ABC):
    """An environment as Brax's trainers, wrappers and viewers use it; `as_brax` makes it a `brax.envs.Env`."""

    @abc.abstractmethod
    def reset(self, rng: jax.Array) -> State:
        """Starts an episode."""

    @abc.abstractmethod
    def step(self, state: State, action: jax.Array) -> State:
        """Takes one step with an action [act]."""

    @property
    @abc.abstractmethod
    def observation_size(self) -> int:
        """Size of the observation."""

    @property
    @abc.abstractmethod
    def action_size(self) -> int:
        """Size of the action."""

    @property
    @abc.abstractmethod
    def backend(self) -> str:
        """Name of the physics engine."""

    @property
    def unwrapped(self) -> Env:
        """The environment without wrappers, itself."""
        return self
