"""Policies as one portable file: parameters, code table, configuration and a card, without replay."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import jax
import numpy as np

from ear_jax.agents.networks import Params
from ear_jax.errors import RunError
from ear_jax.limits import MAX_COUNT
from ear_jax.runs import safetensors
from ear_jax.runs.leaves import named_leaves

FORMAT = "ear_jax policy 1"
ABOUT = {"config": dict, "tasks": list, "engine": str, "epoch": int, "collected": int, "versions": dict}


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
    metadata["sha256_metadata"] = safetensors.digest({}, metadata)
    safetensors.write(path, arrays, {**metadata, "sha256": safetensors.digest(arrays, metadata)})


def read_about(path: Path) -> tuple[dict[str, Any], safetensors.Header]:
    """Returns the `about` given to `write_policy` and the file's header, without reading arrays.

    Raises:
      RunError: it is not a policy file, or its header is damaged.
    """
    header = safetensors.read_header(path)
    metadata = {name: value for name, value in header.metadata.items() if not name.startswith("sha256")}
    if metadata.get("format") != FORMAT:
        raise RunError(f"{path} is not a policy file that this version of ear_jax can read")
    if header.metadata.get("sha256_metadata", safetensors.digest({}, metadata)) != safetensors.digest(
        {}, metadata
    ):  # earlier: only `sha256`
        raise RunError(f"{path} is damaged: it differs from its checksum")
    try:
        about = json.loads(metadata["about"])
        _check_about(about)
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        raise RunError(f"{path} does not describe its policy: {error!r}".splitlines()[0]) from None
    return about, header


def read_policy(path: Path, header: safetensors.Header) -> dict[str, np.ndarray]:
    """Returns the arrays by name; raises RunError if the file is damaged or cannot be read."""
    arrays = safetensors.read_arrays(path, header)
    metadata = dict(header.metadata)
    if metadata.pop("sha256", None) != safetensors.digest(arrays, metadata):
        raise RunError(f"{path} is damaged: it differs from its checksum")
    return arrays


def _check_about(about: Any) -> None:
    """Raises ValueError, TypeError or KeyError for a description that lacks what readers rely on."""
    for name, kind in ABOUT.items():
        if type(about[name]) is not kind:
            raise ValueError(f"{name} is not of type {kind.__name__}")
    if not all(0 <= about[name] <= MAX_COUNT for name in ("epoch", "collected")):
        raise ValueError("its epochs are out of range")
    shown = (about["engine"], about.get("commit"), *about["versions"].values())
    if not all(text is None or (isinstance(text, str) and text.isprintable()) for text in shown):
        raise ValueError("its engine, commit and versions are not plain text")
