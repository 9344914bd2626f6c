"""Matmuls that multiply in bfloat16 and add in float32, faster than float32 on CPUs with instructions for it.

This holds for the forward and the backward pass. Inputs, outputs, parameters and gradients are float32.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp

ALONG_LAST = (((1,), (1,)), ((), ()))  # dot_general's dimension numbers: contract both last axes


@jax.custom_batching.custom_vmap
def bfloat16_matmul(x: jax.Array, kernel: jax.Array) -> jax.Array:
    """Multiplies one item x [in] by a kernel [in, out] as in `flax.linen.Dense`.

    Only reverse-mode gradients exist, and the efficient ones are those of a function that vmaps this one.
    """
    return _of_batch(x[None], kernel)[0]


@bfloat16_matmul.def_vmap
def _(size: int, batched: list[bool], x: jax.Array, kernel: jax.Array) -> tuple[jax.Array, bool]:
    """Multiplies all items at once; per-item products would give one kernel gradient [in, out] for each item."""
    del size
    if not batched[1]:
        return _of_batch(x, kernel), True
    per_kernel = jax.vmap(_of_batch, in_axes=(0 if batched[0] else None, 0))
    return per_kernel(x[..., None, :], kernel)[:, 0], True


@jax.custom_vjp
def _of_batch(x: jax.Array, kernel: jax.Array) -> jax.Array:
    """Multiplies items x [n, in] by a kernel [in, out]."""
    return _forward(x, kernel)[0]


def _forward(x: jax.Array, kernel: jax.Array) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
    x, kernel = x.astype(jnp.bfloat16), kernel.astype(jnp.bfloat16)
    return jnp.dot(x, kernel, preferred_element_type=jnp.float32), (x, kernel)


def _backward(rounded: tuple[jax.Array, jax.Array], grad: jax.Array) -> tuple[Any, Any]:
    x, kernel = rounded
    grad = grad.astype(jnp.bfloat16)
    grad_x = jax.lax.dot_general(grad, kernel, ALONG_LAST, preferred_element_type=jnp.float32)
    # XLA would fuse the transposition into the product, a form without a fast kernel on the CPU. Padding with rows of
    # zeros prevents that and is 3 times as fast.
    transposed = jnp.pad(x.T, ((0, 8), (0, 0)))
    return grad_x, jnp.dot(transposed, grad, preferred_element_type=jnp.float32)[: x.shape[1]]


_of_batch.defvjp(_forward, _backward)
