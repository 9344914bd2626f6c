"""Matmuls that multiply bfloat16 and add float32: several times as fast as float32 where a CPU has AMX.

Forward and backward alike; what goes in and comes out, parameters and gradients included, is float32.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp

ALONG_LAST = (((1,), (1,)), ((), ()))


@jax.custom_batching.custom_vmap
def bfloat16_matmul(x: jax.Array, kernel: jax.Array) -> jax.Array:
    """One item x [in] by a kernel [in, out], as `flax.linen.Dense` has them.

    It is differentiated for a batch: its gradient, backwards alone, is that of a function that vmaps it.
    """
    return _of_batch(x[None], kernel)[0]


@bfloat16_matmul.def_vmap
def _(size: int, batched: list[bool], x: jax.Array, kernel: jax.Array) -> tuple[jax.Array, bool]:
    """A gradient of many items' own products would be as many matrices; of their one product it is one."""
    del size
    if not batched[1]:
        return _of_batch(x, kernel), True
    of_one = jax.vmap(_of_batch, in_axes=(0 if batched[0] else None, 0))
    return of_one(x[..., None, :], kernel)[:, 0], True


@jax.custom_vjp
def _of_batch(x: jax.Array, kernel: jax.Array) -> jax.Array:
    """Items x [n, in] by a kernel [in, out]."""
    return _forward(x, kernel)[0]


def _forward(x: jax.Array, kernel: jax.Array) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
    x, kernel = x.astype(jnp.bfloat16), kernel.astype(jnp.bfloat16)
    return jnp.dot(x, kernel, preferred_element_type=jnp.float32), (x, kernel)


def _backward(rounded: tuple[jax.Array, jax.Array], slope: jax.Array) -> tuple[Any, Any]:
    x, kernel = rounded
    slope = slope.astype(jnp.bfloat16)
    of_x = jax.lax.dot_general(slope, kernel, ALONG_LAST, preferred_element_type=jnp.float32)
    # XLA takes a transposition into the product, and has no fast one of that form on the CPU. It leaves it alone if
    # rows are added, here of zeros: 3 times as fast.
    turned = jnp.pad(x.T, ((0, 8), (0, 0)))
    return of_x, jnp.dot(turned, slope, preferred_element_type=jnp.float32)[: x.shape[1]]


_of_batch.defvjp(_forward, _backward)
