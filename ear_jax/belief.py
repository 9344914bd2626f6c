"""What a task is believed to be from what happened in it: the probabilistic context of PEARL."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
from flax import struct


@struct.dataclass
class Context:
    """Steps [n] of one task, by which it is recognised; in any order."""

    obs: jax.Array  # [n, obs]
    action: jax.Array  # [n, act]
    reward: jax.Array  # [n], scaled as the critics' are
    valid: jax.Array  # bool [n]: the others tell nothing


@struct.dataclass
class Belief:
    """A normal distribution over a task's code, independent in each coordinate."""

    mean: jax.Array  # [code]
    variance: jax.Array  # [code]

    def draw(self, noise: jax.Array) -> jax.Array:
        """The code [code] at standard normal `noise`."""
        return self.mean + jnp.sqrt(self.variance) * noise

    def divergence(self) -> jax.Array:
        """KL divergence from the prior N(0, 1), a scalar."""
        return 0.5 * jnp.sum(self.variance + self.mean**2 - 1 - jnp.log(self.variance))


def prior(size: int) -> Belief:
    """N(0, 1): nothing is known."""
    return Belief(jnp.zeros(size), jnp.ones(size))


def product(means: jax.Array, variances: jax.Array, valid: jax.Array) -> Belief:
    """The product of normal distributions [n, code], of those that are valid [n]; the prior where none is.

    As in the authors' code of PEARL (katerakelly/oyster), the prior is no factor of it.
    """
    precision = jnp.where(valid[:, None], 1 / variances, 0.0)
    total = jnp.sum(precision, axis=0)
    some = jnp.any(valid)
    variance = 1 / jnp.where(some, total, 1.0)
    return Belief(variance * jnp.sum(precision * means, axis=0), variance)


def where(condition: jax.Array, one: Any, other: Any) -> Any:
    """One of two beliefs, leaf by leaf; `condition` has their leading axes."""
    return jax.tree.map(lambda a, b: jnp.where(condition[..., None], a, b), one, other)
