"""From a distribution's parameters to an action: tanh-Gaussian, written for one item."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from flax import struct

LOG_STD_RANGE = (-20.0, 2.0)


@struct.dataclass
class Gaussian:
    """The distribution an action is squashed from."""

    mean: jax.Array  # [act]
    log_std: jax.Array  # [act], within LOG_STD_RANGE


def gaussian(head: jax.Array) -> Gaussian:
    """Splits a decoder's output [2 · act] into a distribution."""
    mean, log_std = jnp.split(head, 2, axis=-1)
    return Gaussian(mean, jnp.clip(log_std, *LOG_STD_RANGE))


def squash(distribution: Gaussian, noise: jax.Array) -> jax.Array:
    """The action [act] in [−1, 1] at standard normal `noise` [act]; at zero noise, tanh of the mean."""
    return jnp.tanh(distribution.mean + jnp.exp(distribution.log_std) * noise)


def sample(distribution: Gaussian, noise: jax.Array) -> tuple[jax.Array, jax.Array]:
    """The action [act] at `noise` and its log-density, a scalar.

    log π = log N(u) − Σ log(1 − tanh²u), the last written as 2(log 2 − u − softplus(−2u)) so that it does not overflow.
    """
    raw = distribution.mean + jnp.exp(distribution.log_std) * noise
    log_normal = -0.5 * noise**2 - distribution.log_std - 0.5 * jnp.log(2 * jnp.pi)
    log_slope = 2 * (jnp.log(2.0) - raw - jax.nn.softplus(-2 * raw))
    return jnp.tanh(raw), jnp.sum(log_normal - log_slope)
