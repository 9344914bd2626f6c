"""PEARL's posterior over a task's code, given steps of that task."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from flax import struct


@struct.dataclass
class Context:
    """Steps [n] of one task, in any order, from which its code is inferred."""

    obs: jax.Array  # [n, obs]
    action: jax.Array  # [n, act]
    reward: jax.Array  # [n], scaled as in the critics' targets
    valid: jax.Array  # bool [n]: False for padding


@struct.dataclass
class Posterior:
    """A normal distribution over a task's code, independent in each coordinate."""

    mean: jax.Array  # [code]
    variance: jax.Array  # [code]

    def sample(self, noise: jax.Array) -> jax.Array:
        """Returns the code [code] for standard normal `noise` [code]."""
        return self.mean + jnp.sqrt(self.variance) * noise

    def kl_to_prior(self) -> jax.Array:
        """Returns the KL divergence from the prior N(0, 1), a scalar."""
        return 0.5 * jnp.sum(self.variance + self.mean**2 - 1 - jnp.log(self.variance))


def prior(size: int) -> Posterior:
    """Returns the prior N(0, 1) over a code [size]."""
    return Posterior(jnp.zeros(size), jnp.ones(size))


def product(means: jax.Array, variances: jax.Array, valid: jax.Array) -> Posterior:
    """Returns the normalised product of the valid normal distributions [n, code], or the prior if none is valid.

    As in PEARL's code (katerakelly/oyster), the prior is not a factor of the product.
    """
    means, precision = (jnp.where(valid[:, None], leaf, 0.0) for leaf in (means, 1 / variances))
    total = jnp.sum(precision, axis=0)
    any_valid = jnp.any(valid)
    variance = 1 / jnp.where(any_valid, total, 1.0)
    return Posterior(variance * jnp.sum(precision * means, axis=0), variance)


def where(condition: jax.Array, one: Posterior, other: Posterior) -> Posterior:
    """Selects between two posteriors; `condition` has their leading axes, without [code]."""
    return jax.tree.map(lambda a, b: jnp.where(condition[..., None], a, b), one, other)
