"""The tanh-Gaussian distribution of actions, written for one item."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from flax import struct

LOG_STD_RANGE = (-20.0, 2.0)


@struct.dataclass
class Gaussian:
    """The normal distribution of an action before tanh."""

    mean: jax.Array  # [act]
    log_std: jax.Array  # [act], within LOG_STD_RANGE


def gaussian(head: jax.Array) -> Gaussian:
    """Splits a decoder's output [2 · act] into mean and clipped log-σ."""
    mean, log_std = jnp.split(head, 2, axis=-1)
    return Gaussian(mean, jnp.clip(log_std, *LOG_STD_RANGE))


def squash(distribution: Gaussian, noise: jax.Array) -> jax.Array:
    """Returns the action [act] in [−1, 1] for standard normal `noise` [act]; zero noise gives tanh of the mean."""
    return jnp.tanh(distribution.mean + jnp.exp(distribution.log_std) * noise)


def sample(distribution: Gaussian, noise: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Returns the action [act] for `noise` [act] and its log-density, a scalar.

    log π = log N(u) − Σ log(1 − tanh²u), where log(1 − tanh²u) = 2(log 2 − u − softplus(−2u)) does not overflow.
    """
    pre_tanh = distribution.mean + jnp.exp(distribution.log_std) * noise
    log_normal = -0.5 * noise**2 - distribution.log_std - 0.5 * jnp.log(2 * jnp.pi)
    log_slope = 2 * (jnp.log(2.0) - pre_tanh - jax.nn.softplus(-2 * pre_tanh))
    return jnp.tanh(pre_tanh), jnp.sum(log_normal - log_slope)
