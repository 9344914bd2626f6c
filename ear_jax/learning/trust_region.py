"""One step of trust region policy optimisation (TRPO) for any loss and divergence of a parameter vector."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax.scipy.sparse.linalg import cg

CG_STEPS, BACKTRACKS, SHRINK = 10, 15, 0.8  # as in tristandeleu/pytorch-maml-rl and jonasrothfuss/ProMP
# Relative to the curvature along the gradient. Theirs, an absolute 1e-5, is below float32's rounding of curvatures of
# 1,000 and more, so that steps could diverge along directions of pure rounding error.
DAMPING = 1e-2

Measure = Callable[[jax.Array], tuple[jax.Array, jax.Array]]  # parameters [n] → loss, divergence


def improve(
    measure: Measure, features: Callable[[jax.Array], Any], start: jax.Array, limit: float
) -> tuple[jax.Array, dict[str, jax.Array]]:
    """Lowers the loss within a limit on the divergence from the start (Schulman et al. 2015, appendix C).

    The direction is the natural gradient, by conjugate gradients on the divergence's curvature JᵀJ, where J is the
    Jacobian of the features at the start. Linearising them once is faster than differentiating the divergence twice in
    each step of conjugate gradients. The step starts at the longest that the limit allows to second order, and
    is shortened until the loss falls and the limit holds.

    Args:
      measure: parameters → the loss, and the divergence from the result of `start`, which is minimal there.
      features: parameters → a pytree; to second order, the divergence is half its squared distance from the start's.
      start: parameters [n].
      limit: the largest divergence allowed.

    Returns:
      The new parameters, which are `start` if no step was accepted, and metrics: the loss before, the divergence after
      and the share of the longest step that was taken.
    """
    loss, gradient = jax.value_and_grad(lambda parameters: measure(parameters)[0])(start)

    _, jacobian = jax.linearize(features, start)
    transposed = jax.linear_transpose(jacobian, start)

    def curvature(vector: jax.Array) -> jax.Array:
        (product,) = transposed(jacobian(vector))
        return product

    along = jnp.vdot(gradient, curvature(gradient)) / jnp.maximum(jnp.vdot(gradient, gradient), 1e-12)
    damping = DAMPING * jnp.maximum(along, 1e-6)
    direction, _ = cg(lambda vector: curvature(vector) + damping * vector, -gradient, tol=1e-10, maxiter=CG_STEPS)
    quadratic = jnp.vdot(direction, curvature(direction) + damping * direction)
    longest = jnp.sqrt(2 * limit / jnp.maximum(quadratic, 1e-12)) * direction

    def rejected(search: tuple[jax.Array, jax.Array]) -> jax.Array:
        backtracks, accepted = search
        return ~accepted & (backtracks < BACKTRACKS)

    def backtrack(search: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        backtracks, _ = search
        new_loss, divergence = measure(start + SHRINK**backtracks * longest)
        accepted = (new_loss < loss) & (divergence <= limit)
        return jnp.where(accepted, backtracks, backtracks + 1), accepted

    backtracks, accepted = jax.lax.while_loop(rejected, backtrack, (jnp.int32(0), jnp.zeros((), bool)))
    step = jnp.where(accepted, SHRINK**backtracks, 0.0)
    end = start + jnp.where(accepted, step * longest, 0.0)
    return end, {"loss": loss, "divergence": measure(end)[1], "step": step}
