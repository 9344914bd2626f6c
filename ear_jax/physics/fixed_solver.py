"""MJX's constraint solver as an accelerator runs it without its host.

MJX ends its Newton iterations when all simulations have converged, which the host reads from the device each time
round, and it solves small linear systems by calls of cuSOLVER and cuBLAS, which break CUDA graphs. Here iterations are
as many as their limit, those of a converged simulation change nothing, and systems are solved by the compiled
program itself. Equations and results are MJX's, up to rounding.
"""

from __future__ import annotations

import importlib.metadata
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import jax.scipy.linalg

from ear_jax.errors import RunError

LARGEST = 24  # rows of a system that is solved in the program; the work of compiling grows with their cube
_tracing = threading.RLock()  # what is replaced belongs to modules, and so to all threads


@contextmanager
def solver_of_mjx(fixed_iterations: int | None) -> Iterator[None]:
    """Traces MJX's steps within, by one thread at a time.

    Args:
      fixed_iterations: the number of Newton iterations of the solver described above; None leaves MJX's own.

    Raises:
      RunError: this version of MJX does not have the parts that are replaced.
    """
    with _tracing:
        replaced = [] if fixed_iterations is None else _replacements(fixed_iterations)
        kept = [(module, name, getattr(module, name)) for module, name, _ in replaced]
        try:
            for module, name, value in replaced:
                setattr(module, name, value)
            yield
        finally:
            for module, name, value in kept:
                setattr(module, name, value)


def _replacements(iterations: int) -> list[tuple[Any, str, Any]]:
    """Returns modules of MJX, names in them, and what these names stand for while a step is traced."""
    from mujoco.mjx._src import forward, smooth, solver

    calls = (
        (solver.solve, "while_loop"),
        (solver._linesearch, "_while_loop_scan"),
        (solver._update_gradient, "cho_solve"),
        (smooth.factor_m, "cho_factor"),
        (smooth.solve_m, "cho_solve"),
    )
    modules = (solver, smooth, forward)
    if any(module.jax is not jax for module in modules) or any(name not in _names(call) for call, name in calls):
        version = importlib.metadata.version("mujoco-mjx")
        raise RunError(f"engine mjx-fixed does not know the solver of mujoco-mjx {version}; use --engine mjx")
    linalg = _over(jax.scipy.linalg, cho_factor=_unfactored, cho_solve=_solve)
    newton = partial(masked_loop, length=iterations)
    ours = _over(jax, scipy=_over(jax.scipy, linalg=linalg), lax=_over(jax.lax, while_loop=newton))
    return [
        *((module, "jax", ours) for module in modules),
        (solver, "_while_loop_scan", partial(masked_loop, unroll=True)),
    ]


def _names(function: Callable[..., Any]) -> tuple[str, ...]:
    """Returns the names of what a function calls."""
    return function.__code__.co_names


def _over(module: Any, **replaced: Any) -> SimpleNamespace:
    return SimpleNamespace(**{**vars(module), **replaced})


def masked_loop(
    cond: Callable[[Any], jax.Array], body: Callable[[Any], Any], init: Any, length: int, unroll: bool = False
) -> Any:
    """Runs `while cond(value): value = body(value)` as a loop of fixed length, which is at least as long.

    Args:
      cond, body: of a pytree.
      init: the pytree at first.
      length: iterations; those after the end change nothing.
      unroll: write the iterations one after the other, without a loop.
    """

    def step(carry: tuple[Any, jax.Array], _: None) -> tuple[tuple[Any, jax.Array], None]:
        value, going = carry
        value = jax.tree.map(partial(jnp.where, going), body(value), value)
        return (value, going & cond(value)), None

    return jax.lax.scan(step, (init, cond(init)), None, length=length, unroll=unroll)[0][0]


def _unfactored(matrix: jax.Array) -> tuple[jax.Array, bool]:
    """Stands for `cho_factor`: each system is factored where it is solved, in one kernel."""
    return matrix, False


def _solve(factored: tuple[jax.Array, bool], vector: jax.Array) -> jax.Array:
    """Stands for `cho_solve`."""
    matrix, _ = factored
    if len(matrix) > LARGEST:
        return jax.scipy.linalg.cho_solve(jax.scipy.linalg.cho_factor(matrix), vector)
    return solve_small(matrix, vector)


def solve_small(matrix: jax.Array, vector: jax.Array) -> jax.Array:
    """Solves a small symmetric positive definite system by Cholesky's method, written out in scalars.

    Under `vmap` every scalar is an array over the batch and every operation elementwise, so XLA makes one kernel of it.

    Args:
      matrix: [n, n], of which the lower triangle is read.
      vector: [n].

    Returns:
      x in matrix @ x = vector, [n].
    """
    size = len(vector)
    lower: list[list[jax.Array]] = []  # rows of the factor, without its diagonal
    scale: list[jax.Array] = []  # one over its diagonal
    forward: list[jax.Array] = []
    for i in range(size):
        row: list[jax.Array] = []
        for j in range(i):
            row.append(_less(matrix[i, j], row, lower[j]) * scale[j])
        scale.append(jax.lax.rsqrt(_less(matrix[i, i], row, row)))
        forward.append(_less(vector[i], row, forward) * scale[i])
        lower.append(row)
    solution: list[jax.Array] = []  # from its last number
    for i in reversed(range(size)):
        column = [lower[k][i] for k in range(size - 1, i, -1)]
        solution.append(_less(forward[i], column, solution) * scale[i])
    return jnp.stack(solution[::-1])


def _less(value: jax.Array, one: list[jax.Array], other: list[jax.Array]) -> jax.Array:
    """Returns a number less the products of two lists."""
    for a, b in zip(one, other, strict=True):
        value = value - a * b
    return value
