"""Exploration noise that is held for several steps."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp


def held_noise(noise: jax.Array, key: jax.Array, limit: int) -> jax.Array:
    """Holds each environment's noise for k steps, k ≤ `limit`, with probability ∝ k⁻² (Holiday-Robot/FlashSAC).

    Args:
      noise: standard normal [steps, tasks, envs, act].
      key: seeds the times.
      limit: the longest; 1 returns the noise as it is.
    """
    if limit == 1:
        return noise
    times = jax.random.categorical(key, -2 * jnp.log(jnp.arange(1, limit + 1)), shape=noise.shape[:3]) + 1

    def step(carry: tuple[jax.Array, jax.Array], new: tuple[jax.Array, jax.Array]) -> tuple[Any, jax.Array]:
        (current, left), (fresh, time) = carry, new
        over = left == 0
        current, left = jnp.where(over[..., None], fresh, current), jnp.where(over, time, left)
        return (current, left - 1), current

    return jax.lax.scan(step, (jnp.zeros_like(noise[0]), jnp.zeros_like(times[0])), (noise, times))[1]
