"""An agent without training, whose action is the first number of its code."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from ear_jax.agents import Agent
from ear_jax.agents.networks import unit_vector
from ear_jax.agents.tanh_gaussian import Gaussian

# Codes of the two tasks on a great circle, along which the action goes from −0.5 to 0.5.
CODES = jnp.array([[-0.5, np.sqrt(0.75), 0.0], [0.5, np.sqrt(0.75), 0.0]])


def obedient(codes: jax.Array, sphere: bool = True) -> Agent:
    def distribution(policy, code, obs):
        return Gaussian(jnp.arctanh(jnp.clip(code[:1], -0.999, 0.999)), jnp.full(1, -9.0))

    def nothing(*_):
        return None

    return Agent(3, nothing, lambda policy: codes, unit_vector, distribution, None, on_sphere=sphere, embed=nothing)
