"""New codes from old ones by blending, and codes spread over the sphere."""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

Project = Callable[[jax.Array], jax.Array]


def blend(first: jax.Array, second: jax.Array, beta: jax.Array, project: Project) -> jax.Array:
    """Returns f(β Z₁ + (1 − β) Z₂) (equation 1): the first code at β = 1, the second at 0, extrapolation elsewhere.

    Args:
      first, second: codes [code].
      beta: a scalar.
      project: f, which maps any vector to the nearest code.
    """
    return project(beta * first + (1 - beta) * second)


def slerp(first: jax.Array, second: jax.Array, beta: jax.Array) -> jax.Array:
    """Follows the great circle through two unit vectors [code] at constant speed in β; β = 1 is the first.

    The circle is spanned by `second` and the component of `first` perpendicular to it. This holds for β outside [0, 1],
    and for two equal codes, whose blend is that code. Through opposite codes it takes one of the circles.
    """
    cosine = jnp.clip(jnp.dot(first, second), -1, 1)
    across = first - cosine * second
    angle = beta * jnp.arctan2(jnp.linalg.norm(across), cosine)
    aside = jax.nn.one_hot(jnp.argmin(jnp.abs(second)), len(second))  # the axis least along them
    across = jnp.where(jnp.linalg.norm(across) > 1e-6, across, aside - jnp.dot(aside, second) * second)
    direction = across / jnp.maximum(jnp.linalg.norm(across), 1e-9)
    return jnp.cos(angle) * second + jnp.sin(angle) * direction


def fibonacci_sphere(count: int) -> np.ndarray:
    """Spreads `count` unit vectors [count, 3] evenly: equal steps in height, turned by the golden angle each."""
    height = 1 - (2 * np.arange(count) + 1) / count
    angle = np.arange(count) * np.pi * (3 - np.sqrt(5))
    radius = np.sqrt(1 - height**2)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=-1).astype(np.float32)


def spread_codes(count: int, size: int) -> np.ndarray:
    """Spreads `count` unit vectors [count, size].

    They are even in two and three dimensions, and random with a fixed seed in others.
    """
    if size == 3:
        return fibonacci_sphere(count)
    if size == 2:
        angle = 2 * np.pi * np.arange(count) / count
        return np.stack([np.cos(angle), np.sin(angle)], axis=-1).astype(np.float32)
    directions = np.random.default_rng(0).normal(size=(count, size))
    return np.asarray(directions / np.linalg.norm(directions, axis=1, keepdims=True), np.float32)
