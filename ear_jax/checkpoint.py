"""Saving and restoring whole training states through Orbax. The only module that calls it."""

from __future__ import annotations

import logging
import os
import shutil
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import orbax.checkpoint as ocp

logging.getLogger("absl").setLevel(logging.ERROR)  # Orbax narrates every save

KEEP = 2  # newest steps kept


def save(directory: Path, epoch: int, state: Any) -> None:
    """Writes a step, whole or not at all, and then drops all but the newest few.

    Args:
      directory: the run's `checkpoints`.
      epoch: the step's name.
      state: any pytree of arrays, random keys included.
    """
    final = (directory / str(epoch)).absolute()
    scratch = final.with_name(f".{epoch}.part")
    shutil.rmtree(scratch, ignore_errors=True)
    directory.mkdir(parents=True, exist_ok=True)
    ocp.PyTreeCheckpointer().save(scratch, _bare_keys(state))
    shutil.rmtree(final, ignore_errors=True)
    os.replace(scratch, final)
    for old in steps(directory)[:-KEEP]:
        shutil.rmtree(directory / str(old), ignore_errors=True)


def steps(directory: Path) -> list[int]:
    """The epochs of the finished steps, ascending."""
    if not directory.is_dir():
        return []
    return sorted(int(path.name) for path in directory.iterdir() if path.name.isdigit())


def restore(directory: Path, epoch: int, like: Any, only: Any = None) -> Any:
    """Reads a step.

    Args:
      directory: the run's `checkpoints`.
      epoch: which step.
      like: the state's structure, of arrays or their shapes.
      only: a tree of bools with `like`'s structure; leaves that are False come back as `...` and are not read.

    Returns:
      The state.
    """
    bare = jax.eval_shape(_bare_keys, like)
    wanted = bare if only is None else jax.tree.map(lambda leaf, want: leaf if want else ocp.PLACEHOLDER, bare, only)
    arguments = ocp.checkpoint_utils.construct_restore_args(wanted)
    path = (directory / str(epoch)).absolute()
    state = ocp.PyTreeCheckpointer().restore(path, item=wanted, restore_args=arguments)
    return jax.tree.map(_with_key, like, state)


def _bare_keys(state: Any) -> Any:
    """Random keys as the integers they are made of: Orbax knows no key types."""
    return jax.tree.map(lambda leaf: jax.random.key_data(leaf) if _is_key(leaf) else leaf, state)


def _with_key(like: Any, leaf: Any) -> Any:
    if leaf is ...:
        return leaf
    return jax.random.wrap_key_data(leaf) if _is_key(like) else jnp.asarray(leaf)


def _is_key(leaf: Any) -> bool:
    return jax.dtypes.issubdtype(leaf.dtype, jax.dtypes.prng_key)
