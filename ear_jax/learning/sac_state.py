"""The state of SAC's learner, and the result of a step of its critics."""

from __future__ import annotations

from typing import Any

import jax
import optax
from flax import struct

from ear_jax.agents.networks import Params
from ear_jax.learning.learner import Metrics

CRITICS = 2


@struct.dataclass
class SacState:
    """Parameters, temperature and their optimisers."""

    policy: Params
    critics: Params  # each leaf [critics, …]
    target_critics: Params
    log_temperature: jax.Array  # a scalar, or [tasks] if each task has its own
    policy_optimiser: Any
    critic_optimiser: Any  # each leaf [critics, …]
    temperature_optimiser: Any

    @property
    def norms(self) -> Metrics:
        """Global norms by name; each is finite only if all of its numbers are."""
        return {
            "policy_norm": optax.global_norm(self.policy),
            "critics_norm": optax.global_norm((self.critics, self.target_critics)),
            "temperature_norm": optax.global_norm(self.log_temperature),
        }


@struct.dataclass
class CriticStep:
    """The result of differentiating the critics' loss on one batch."""

    grad: Params  # each leaf [critics, …]
    policy_grad: Params | None  # of the same loss, if it also trains part of the policy
    loss: jax.Array  # scalar
    losses: jax.Array  # [critics, n]
    values: jax.Array  # Q [critics, n]
    statistics: Params  # new running statistics of critics with BatchNorm, each leaf [critics, …]; else empty
