"""Policies as one portable file: parameters, code table, configuration and a card, without replay."""

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
    """Writes policies to a file in the safetensors format.

    Args:
      path: the file.
      policies: each leaf [seeds, …].
      codes: the code tables [seeds, tasks, code], for readers without ear_jax.
      about: a JSON document with configuration, tasks and versions.
      card: a description for people.

    Raises:
      RunError: the file cannot be written.
    """
    arrays = {name: np.asarray(leaf) for name, leaf in named_leaves({"policy": policies, "codes": codes}).items()}
    metadata = {"format": FORMAT, "about": json.dumps(about), "card": card}
    safetensors.write(path, arrays, {**metadata, "sha256": _digest(arrays, metadata)})


def read_policy(path: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Returns the `about` given to `write_policy`, and the arrays by name.

    Raises:
      RunError: it is not a policy file, or it is damaged.
    """
    arrays, metadata = safetensors.read(path)
    if metadata.get("format") != FORMAT:
        raise RunError(f"{path} is not a policy file that this version of ear_jax can read")
    if metadata.pop("sha256", None) != _digest(arrays, metadata):
        raise RunError(f"{path} is damaged: it differs from its checksum")
    return json.loads(metadata["about"]), arrays


def _digest(arrays: dict[str, np.ndarray], metadata: dict[str, str]) -> str:
    digest = hashlib.sha256(json.dumps(metadata, sort_keys=True).encode())
    for name, array in sorted(arrays.items()):
        digest.update(f"{name} {array.dtype} {array.shape} ".encode())
        digest.update(np.ascontiguousarray(array))
    return digest.hexdigest()
