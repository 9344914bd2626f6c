"""One step of trust region policy optimisation, on any loss and divergence of a vector of parameters."""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax.scipy.sparse.linalg import cg

CG_STEPS, BACKTRACKS, SHRINK = 10, 15, 0.8  # as in tristandeleu/pytorch-maml-rl and jonasrothfuss/ProMP
# Of the curvature along the gradient. Theirs, 1e-5, is less than what float32 knows of a curvature of 1,000 and more,
# and lets steps run away along directions that are rounding.
DAMPING = 1e-2

Measure = Callable[[jax.Array], tuple[jax.Array, jax.Array]]


def improve(measure: Measure, start: jax.Array, limit: float) -> tuple[jax.Array, dict[str, jax.Array]]:
    """Goes down the loss as far as the divergence from where it started allows (Schulman et al. 2015, appendix C).

    The direction is the natural gradient, by conjugate gradients on the divergence's curvature; the step is the longest
    that the limit allows to second order, and is shortened until loss and divergence agree.

    Args:
      measure: parameters → the loss, and the divergence from what `start` gives, whose minimum is there.
      start: parameters [n].
      limit: of the divergence.

    Returns:
      The parameters then, which are `start` where no step would do, and what to watch: the loss before, the divergence
      after, and the part of the longest step that was taken.
    """
    loss, gradient = jax.value_and_grad(lambda where: measure(where)[0])(start)

    def curvature(vector: jax.Array) -> jax.Array:
        slope = jax.grad(lambda where: measure(where)[1])
        return jax.jvp(slope, (start,), (vector,))[1]

    along = jnp.vdot(gradient, curvature(gradient)) / jnp.maximum(jnp.vdot(gradient, gradient), 1e-12)
    damping = DAMPING * jnp.maximum(along, 1e-6)
    direction, _ = cg(lambda vector: curvature(vector) + damping * vector, -gradient, tol=1e-10, maxiter=CG_STEPS)
    bend = jnp.vdot(direction, curvature(direction) + damping * direction)
    longest = jnp.sqrt(2 * limit / jnp.maximum(bend, 1e-12)) * direction

    def refused(tried: tuple[jax.Array, jax.Array]) -> jax.Array:
        times, accepted = tried
        return ~accepted & (times < BACKTRACKS)

    def shorten(tried: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        times, _ = tried
        reached, divergence = measure(start + SHRINK**times * longest)
        accepted = (reached < loss) & (divergence <= limit)
        return jnp.where(accepted, times, times + 1), accepted

    times, accepted = jax.lax.while_loop(refused, shorten, (jnp.int32(0), jnp.zeros((), bool)))
    part = jnp.where(accepted, SHRINK**times, 0.0)
    end = start + jnp.where(accepted, part * longest, 0.0)
    return end, {"loss": loss, "divergence": measure(end)[1], "step": part}
