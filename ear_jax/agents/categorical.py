"""Categorical critics (C51): a prediction is the logits of bins of return [bins], spread evenly over ± a limit.

Bellemare et al. 2017, arXiv 1707.06887; with the soft target of naumix/BiggerRegularizedCategorical.
"""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp


def value(logits: jax.Array, limit: float) -> jax.Array:
    """Returns Q, the mean of the distribution; [bins] → scalar."""
    return jax.nn.softmax(logits) @ jnp.linspace(-limit, limit, len(logits))


def target(
    next_logits: jax.Array, pessimism: float, bellman: Callable[[jax.Array], jax.Array], limit: float
) -> jax.Array:
    """Moves the next distribution by the Bellman operator and projects it onto the bins.

    The next distribution is the mean over critics, so pessimism mixes in the critic with the lesser mean. Each bin's
    mass goes to the two bins nearest to where it moved, in proportion to its closeness.

    Args:
      next_logits: the target critics', [critics, bins].
      pessimism: 0 takes the mean distribution, 1 that of the critic with the lesser Q, linear between.
      bellman: a next value → r + γ (value − α log π).
      limit: the largest bin.

    Returns:
      Masses [bins], which sum to one.
    """
    bins = jnp.linspace(-limit, limit, next_logits.shape[-1])
    masses = jax.nn.softmax(next_logits)
    lesser = masses[jnp.argmin(masses @ bins)]
    mixed = pessimism * lesser + (1 - pessimism) * jnp.mean(masses, axis=0)
    moved = jnp.clip(bellman(bins), -limit, limit)
    share = jnp.clip(1 - jnp.abs(bins[:, None] - moved) / (bins[1] - bins[0]), 0, 1)  # [bins, moved bins]
    return share @ mixed


def loss(logits: jax.Array, masses: jax.Array) -> jax.Array:
    """Returns the cross-entropy of predicted logits [bins] and target masses [bins], a scalar."""
    return -masses @ jax.nn.log_softmax(logits)
