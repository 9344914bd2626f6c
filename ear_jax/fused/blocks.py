"""Layers inside a kernel, forward and backward, for a block of rows that never leaves the processor.

A value [rows, width] is a list of its columns in chunks, as Triton can multiply chunks but not cut them out of a value.
All parameters of a network are rows of one matrix [rows, width], its `pack`: weights [in, width] are `in` rows, weights
[width, out] are stored transposed, and each vector is a row.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
from jax.experimental import pallas as pl

from ear_jax.process.target import on_accelerator

CHUNK = 64  # columns; widths are multiples of it
NORM_EPSILON = 1e-6  # of `flax.linen.LayerNorm`

Chunks = list[jax.Array]  # each [rows, columns]


@dataclass(frozen=True)
class Pack:
    """A network's parameters as a kernel reads them."""

    ref: Any  # [rows, width]
    width: int
    bfloat16: bool  # round factors of hidden layers to bfloat16; otherwise a GPU rounds to TF32, and a CPU does not

    @property
    def columns(self) -> list[Any]:
        """The slice of each chunk."""
        return [pl.ds(start, CHUNK) for start in range(0, self.width, CHUNK)]

    def vector(self, row: int) -> Chunks:
        """Returns a vector [width], each chunk [1, columns]."""
        return [self.ref[row, columns][None, :] for columns in self.columns]

    def narrow(self, row: int, start: int, size: int) -> jax.Array:
        """Returns a part of a row, [1, size]."""
        return self.ref[row, pl.ds(start, size)][None, :]

    def dot(self, x: jax.Array, weights: jax.Array, transposed: bool = False) -> jax.Array:
        """Multiplies x [rows, in] by weights [in, out], or by the transpose of weights [out, in]."""
        if self.bfloat16:
            x, weights = x.astype(jnp.bfloat16), weights.astype(jnp.bfloat16)
        return dot(x, weights, transposed)

    def widen(self, xs: Chunks, row: int) -> Chunks:
        """Multiplies a value by the weights [in, width] that begin at a row."""
        return [
            total(self.dot(x, self._weights(xs, row, index, columns)) for index, x in enumerate(xs))
            for columns in self.columns
        ]

    def widen_back(self, grads: Chunks, row: int, size: int) -> Chunks:
        """Returns the gradient by the input [rows, size] of `widen`, in chunks if it is as wide as a layer."""
        step = CHUNK if size == self.width else size
        pairs = list(zip(grads, self.columns, strict=True))
        return [
            total(self.dot(grad, self.ref[pl.ds(row + start, step), columns], True) for grad, columns in pairs)
            for start in range(0, size, step)
        ]

    def narrow_down(self, xs: Chunks, row: int, size: int) -> jax.Array:
        """Multiplies a value by a last layer [rows, size], which is stored transposed from a row on."""
        pairs = zip(xs, self.columns, strict=True)
        return total(dot(x, self.ref[pl.ds(row, size), columns], True) for x, columns in pairs)

    def narrow_down_back(self, grad: jax.Array, row: int) -> Chunks:
        """Returns the gradient by the input of `narrow_down`."""
        rows = pl.ds(row, grad.shape[1])
        return [dot(grad, self.ref[rows, columns]) for columns in self.columns]

    def _weights(self, xs: Chunks, row: int, index: int, columns: Any) -> jax.Array:
        return self.ref[pl.ds(row + index * CHUNK, xs[index].shape[1]), columns]


def dot(x: jax.Array, weights: jax.Array, transposed: bool = False) -> jax.Array:
    """Multiplies x [rows, in] by weights [in, out], or by the transpose of weights [out, in], and adds in float32."""
    return product(x, weights, (((1,), (1 if transposed else 0,)), ((), ())))


def product(left: jax.Array, right: jax.Array, dimensions: Any) -> jax.Array:
    """Multiplies as `jax.lax.dot_general` and adds in float32, whatever the factors' dtype."""
    if not on_accelerator():  # a CPU may have no such product of bfloat16; that of the same numbers in float32 is equal
        left, right = left.astype(jnp.float32), right.astype(jnp.float32)
    return jax.lax.dot_general(left, right, dimensions, preferred_element_type=jnp.float32)


def total(parts: Any) -> jax.Array:
    """Adds up arrays."""
    first, *others = parts
    for other in others:
        first = first + other
    return first


def add(xs: Chunks, ys: Chunks) -> Chunks:
    """Adds two values."""
    return [x + y for x, y in zip(xs, ys, strict=True)]


def relu(xs: Chunks) -> Chunks:
    """Returns the positive part."""
    return [jnp.maximum(x, 0.0) for x in xs]


def masked(grads: Chunks, xs: Chunks) -> Chunks:
    """Returns the gradient by the input of `relu`, which was `xs`."""
    return [jnp.where(x > 0, grad, 0.0) for grad, x in zip(grads, xs, strict=True)]


def normalised(xs: Chunks, width: int) -> tuple[Chunks, jax.Array]:
    """Standardises each row, as LayerNorm does before its scale; also returns 1 / standard deviation [rows, 1]."""
    mean = _row_sum(xs) / width
    square = _row_sum([x * x for x in xs]) / width
    inverse = jax.lax.rsqrt(jnp.maximum(square - mean * mean, 0.0) + NORM_EPSILON)
    return [(x - mean) * inverse for x in xs], inverse


def normalised_back(grads: Chunks, outputs: Chunks, inverse: jax.Array) -> Chunks:
    """Returns the gradient by the input of `normalised`, from its results."""
    width = sum(grad.shape[1] for grad in grads)
    mean = _row_sum(grads) / width
    along = _row_sum([grad * output for grad, output in zip(grads, outputs, strict=True)]) / width
    return [inverse * (grad - mean - output * along) for grad, output in zip(grads, outputs, strict=True)]


def _row_sum(xs: Chunks) -> jax.Array:
    return total(jnp.sum(x, axis=1, keepdims=True) for x in xs)


def write(ref: Any, xs: Chunks) -> None:
    """Writes a value [rows, width]."""
    for index, x in enumerate(xs):
        ref[:, pl.ds(index * x.shape[1], x.shape[1])] = x.astype(ref.dtype)


def write_sums(ref: Any, row: int, xs: Chunks) -> None:
    """Writes a value's sum over rows as a row."""
    for index, x in enumerate(xs):
        ref[row, pl.ds(index * x.shape[1], x.shape[1])] = jnp.sum(x, axis=0)
