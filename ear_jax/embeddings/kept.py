"""Arrays that an analysis keeps beside a run for later ones, with the policy that they are of."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from ear_jax.envs.signature import first_change
from ear_jax.errors import RunError
from ear_jax.runs import safetensors
from ear_jax.runs.trained import Trained

Shape = tuple[int | None, ...]  # None: any size


def write_kept(path: Path, arrays: dict[str, np.ndarray], trained: Trained, kind: str) -> None:
    """Writes arrays of one kind, as in `ear_jax survey 1`; raises RunError if they cannot be written."""
    metadata = {"format": kind, "policy": trained.fingerprint, "engine": trained.program.family.engine.name}
    if signature := trained.program.signature:
        metadata["signature"] = json.dumps(signature)
    safetensors.write(path, arrays, {**metadata, "sha256": safetensors.digest(arrays, metadata)})


def read_kept(path: Path, shapes: dict[str, Shape], trained: Trained, kind: str) -> dict[str, np.ndarray]:
    """Reads arrays that were kept for the same policy and engine.

    Raises:
      RunError: the file is damaged, of another kind, policy or engine, or its arrays have other shapes.
    """
    arrays, metadata = safetensors.read(path)
    if metadata.get("format") != kind:
        raise RunError(f"{path} is not of the format {kind}")
    if metadata.pop("sha256", None) != safetensors.digest(arrays, metadata):
        raise RunError(f"{path} is damaged: it differs from its checksum")
    if (metadata.get("policy"), metadata.get("engine")) != (trained.fingerprint, trained.program.family.engine.name):
        raise RunError(f"{path} is of another policy or engine")
    before, now = json.loads(metadata.get("signature", "null")), trained.program.signature
    if (before is None) != (now is None) or (before and now and first_change(before, now)):
        raise RunError(f"{path} is of other code of the family")
    if arrays.keys() != shapes.keys() or not all(_fits(arrays[name].shape, shapes[name]) for name in shapes):
        raise RunError(f"{path} is of another family")
    return arrays


def _fits(shape: tuple[int, ...], wanted: Shape) -> bool:
    return len(shape) == len(wanted) and all(need in (None, size) for size, need in zip(shape, wanted, strict=True))
