"""Pytrees as flat dictionaries of named arrays, the form in which they are saved and compared."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import jax
import numpy as np

Leaves = dict[str, Any]  # e.g. learner.policy.networks.encoder.params.Dense_0.kernel → array
Layout = dict[str, list]  # name → [dtype, shape]


def named_leaves(tree: Any) -> Leaves:
    """Returns a pytree's leaves, arrays or their shapes, by path; random keys become their integers."""
    paths, _ = jax.tree_util.tree_flatten_with_path(tree)
    return {jax.tree_util.keystr(path, simple=True, separator="."): _without_key(leaf) for path, leaf in paths}


def rebuild(like: Any, leaves: Mapping[str, np.ndarray | jax.Array]) -> Any:
    """Builds a pytree of `like`'s structure from named leaves; arrays of NumPy go to JAX's default device."""
    found = [leaves[name] for name in named_leaves(like)]
    arrays = [leaf if isinstance(leaf, jax.Array) else jax.device_put(np.asarray(leaf)) for leaf in found]
    templates, structure = jax.tree.flatten(like)
    pairs = zip(templates, arrays, strict=True)
    new = [jax.random.wrap_key_data(array) if _is_key(template) else array for template, array in pairs]
    return jax.tree.unflatten(structure, new)


def layout(leaves: Leaves) -> Layout:
    """Returns the dtype and shape of each leaf."""
    return {name: [str(leaf.dtype), list(leaf.shape)] for name, leaf in leaves.items()}


def first_difference(wanted: Layout, found: Layout, partly: bool = False) -> str | None:
    """Describes the first difference between two layouts; None if they agree.

    Args:
      wanted: the layout expected here.
      found: the layout of a file or checkpoint.
      partly: allow `found` to hold more.
    """
    for name, kind in wanted.items():
        if name not in found:
            return f"it has no {name}"
        if found[name] != kind:
            return f"{name} is {_format(found[name])}, not {_format(kind)}"
    extra = [] if partly else [name for name in found if name not in wanted]
    return f"it has {extra[0]}, which is not expected" if extra else None


def _format(kind: list) -> str:
    return f"{kind[0]} {kind[1]}"


def _without_key(leaf: Any) -> Any:
    if not _is_key(leaf):
        return leaf
    shapes_only = isinstance(leaf, jax.ShapeDtypeStruct)
    return jax.eval_shape(jax.random.key_data, leaf) if shapes_only else jax.random.key_data(leaf)


def _is_key(leaf: Any) -> bool:
    return jax.dtypes.issubdtype(leaf.dtype, jax.dtypes.prng_key)
