"""A policy as one file that loads anywhere: parameters, code table, configuration and a card, and no replay."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import jax
import numpy as np

from ear_jax.agents.networks import Params
from ear_jax.errors import RunError
from ear_jax.runs import safetensors
from ear_jax.runs.leaves import named_leaves

FORMAT = "ear_jax policy 1"
SUFFIX = ".safetensors"


def write_policy(path: Path, policies: Params, codes: jax.Array, about: dict[str, Any], card: str) -> None:
    """Writes a file in the safetensors format.

    Args:
      path: the file.
      policies: each leaf [seeds, …].
      codes: the code tables [seeds, tasks, code], for readers that know nothing of ear_jax.
      about: configuration, tasks, versions, as JSON holds it.
      card: what a person should know of it.

    Raises:
      RunError: it cannot be written.
    """
    arrays = {name: np.asarray(leaf) for name, leaf in named_leaves({"policy": policies, "codes": codes}).items()}
    told = {"format": FORMAT, "about": json.dumps(about), "card": card}
    safetensors.write(path, arrays, {**told, "sha256": _digest(arrays, told)})


def read_policy(path: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """What `write_policy` was told, and the arrays by name.

    Raises:
      RunError: it is no such file, or a damaged one.
    """
    arrays, told = safetensors.read(path)
    if told.get("format") != FORMAT:
        raise RunError(f"{path} is no policy that this version of ear_jax exported")
    if told.pop("sha256", None) != _digest(arrays, told):
        raise RunError(f"{path} is damaged: it differs from its checksum")
    return json.loads(told["about"]), arrays


def _digest(arrays: dict[str, np.ndarray], told: dict[str, str]) -> str:
    digest = hashlib.sha256(json.dumps(told, sort_keys=True).encode())
    for name, array in sorted(arrays.items()):
        digest.update(f"{name} {array.dtype} {array.shape} ".encode())
        digest.update(np.ascontiguousarray(array))
    return digest.hexdigest()
