"""Launches of kernels over blocks of a batch's rows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax.experimental import pallas as pl
from jax.experimental.pallas import triton

from ear_jax.process.target import on_accelerator

LEAST_ROWS = 16  # of a block, the least that Triton multiplies
FORWARD_ROWS, BACKWARD_ROWS = 32, LEAST_ROWS  # a backward pass keeps more values
WARPS = 8


def launch(
    kernel: Callable[..., None],
    name: str,
    rows: int,
    batched: Sequence[jax.Array],
    pack: jax.Array,
    results: Sequence[tuple[int, Any]],
    sums: int = 0,
) -> list[jax.Array]:
    """Runs a kernel on every block of a batch; on a CPU Pallas interprets it.

    Args:
      kernel: (a ref for each of `batched`, the pack's ref, a ref for each result) → None.
      name: of the kernel, for traces.
      rows: of a block; 16 if that many do not divide the batch, which has to be a multiple of 16.
      batched: arrays [n, columns].
      pack: the network's parameters [rows, width], which every block reads whole.
      results: columns and dtype of each result [n, columns].
      sums: rows of a further result [blocks, sums, width], for sums over a block; 0 for none.

    Returns:
      The results.
    """
    n, width = batched[0].shape[0], pack.shape[1]
    rows = rows if n % rows == 0 else LEAST_ROWS
    shapes = [jax.ShapeDtypeStruct((n, columns), dtype) for columns, dtype in results]
    outputs = [_rows(rows, columns) for columns, _ in results]
    if sums:
        shapes.append(jax.ShapeDtypeStruct((n // rows, sums, width), jnp.float32))
        outputs.append(pl.BlockSpec((None, sums, width), lambda block: (block, 0, 0)))
    interpret = not on_accelerator()
    call = pl.pallas_call(
        kernel,
        name=name,
        grid=(n // rows,),
        in_specs=[*(_rows(rows, array.shape[1]) for array in batched), pl.BlockSpec(pack.shape, lambda _: (0, 0))],
        out_specs=outputs,
        out_shape=shapes,
        interpret=interpret,
        compiler_params=None if interpret else triton.CompilerParams(num_warps=WARPS, num_stages=2),
    )
    return list(call(*batched, pack))


def _rows(rows: int, columns: int) -> pl.BlockSpec:
    return pl.BlockSpec((rows, columns), lambda block: (block, 0))
