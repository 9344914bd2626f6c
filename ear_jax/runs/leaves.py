"""Pytrees as flat dictionaries of named arrays: what is written to a file, and how two of them are compared."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

Leaves = dict[str, Any]  # such as learner.policy.encoder.params.Dense_0.kernel → array
Layout = dict[str, list]  # the same names → [dtype, shape]


def named_leaves(tree: Any) -> Leaves:
    """A pytree's leaves, arrays or their shapes, by path; random keys as the integers they are made of."""
    paths, _ = jax.tree_util.tree_flatten_with_path(tree)
    return {jax.tree_util.keystr(path, simple=True, separator="."): _without_key(leaf) for path, leaf in paths}


def rebuild(like: Any, leaves: Mapping[str, np.ndarray]) -> Any:
    """The pytree of `like`'s structure whose leaves were named so, on JAX's default device."""
    arrays = [jnp.asarray(leaves[name]) for name in named_leaves(like)]
    old, structure = jax.tree.flatten(like)
    pairs = zip(old, arrays, strict=True)
    new = [jax.random.wrap_key_data(array) if _is_key(leaf) else array for leaf, array in pairs]
    return jax.tree.unflatten(structure, new)


def layout(leaves: Leaves) -> Layout:
    """Dtype and shape of each."""
    return {name: [str(leaf.dtype), list(leaf.shape)] for name, leaf in leaves.items()}


def first_difference(wanted: Layout, found: Layout, partly: bool = False) -> str | None:
    """Where `found` is not as wanted, in words; None where it is.

    Args:
      wanted, found: layouts.
      partly: more may be found than is wanted.
    """
    for name, kind in wanted.items():
        if name not in found:
            return f"it has no {name}"
        if found[name] != kind:
            return f"{name} is {_shown(found[name])} there and {_shown(kind)} here"
    more = [] if partly else [name for name in found if name not in wanted]
    return f"it has {more[0]}, which is unknown here" if more else None


def _shown(kind: list) -> str:
    return f"{kind[0]} {kind[1]}"


def _without_key(leaf: Any) -> Any:
    if not _is_key(leaf):
        return leaf
    shapes_only = isinstance(leaf, jax.ShapeDtypeStruct)
    return jax.eval_shape(jax.random.key_data, leaf) if shapes_only else jax.random.key_data(leaf)


def _is_key(leaf: Any) -> bool:
    return jax.dtypes.issubdtype(leaf.dtype, jax.dtypes.prng_key)
