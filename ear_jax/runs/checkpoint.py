"""Saving and restoring training states through Orbax, which only this module calls.

A step is a directory named by its epoch. It holds Orbax's `state/`, `about.json` (the run and the layout of its state)
and a manifest of checksums. It is written under a temporary name and then renamed, so a step is complete or absent. The
newest good step is found by listing the directory and verifying checksums.
"""

from __future__ import annotations

import json
import logging
import os
import shutil
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ear_jax.errors import RunError
from ear_jax.runs import manifest, records
from ear_jax.runs.leaves import first_difference, layout, named_leaves, rebuild

_default_unraisablehook = sys.unraisablehook


def _ignore_closed_loop(unraisable: sys.UnraisableHookArgs) -> None:
    """Reports exceptions that cannot be raised, except those of writes that Orbax abandoned.

    Orbax closes its event loop at the first failed write, and each pending write of TensorStore then fails with
    "Event loop is closed".
    """
    if str(unraisable.exc_value) != "Event loop is closed":
        _default_unraisablehook(unraisable)


def _orbax() -> Any:
    """Returns Orbax, which takes a second to import and which an exported file does without."""
    import orbax.checkpoint

    logging.getLogger("absl").setLevel(logging.CRITICAL)  # Orbax logs every save; failures are also raised
    sys.unraisablehook = _ignore_closed_loop
    return orbax.checkpoint


FORMAT = 1
KEEP = 2  # number of newest steps to keep


@dataclass(frozen=True)
class Step:
    """A step whose checksums hold."""

    epoch: int
    path: Path
    about: dict[str, Any]  # the `about` given to `save`, and the state's layout


def save(directory: Path, epoch: int, state: Any, about: dict[str, Any]) -> None:
    """Writes a step atomically, then deletes the steps that need not be kept.

    Args:
      directory: the run's `checkpoints`.
      epoch: the step's name.
      state: any pytree of arrays, including random keys.
      about: a JSON document that describes the run.

    Raises:
      RunError: the step could not be written; earlier steps are unchanged.
    """
    final, scratch = directory / str(epoch), directory / f".{epoch}.part"
    leaves = named_leaves(state)
    try:
        directory.mkdir(parents=True, exist_ok=True)
        for leftover in directory.glob(".*.part"):  # from processes that were killed
            shutil.rmtree(leftover)
        scratch.mkdir()
        ocp = _orbax()
        with ocp.Checkpointer(ocp.PyTreeCheckpointHandler()) as orbax:
            orbax.save((scratch / "state").absolute(), leaves)
        document = {**about, "format": FORMAT, "epoch": epoch, "leaves": layout(leaves)}
        records.write_json(scratch / "about.json", document)
        manifest.write(scratch)
        shutil.rmtree(final, ignore_errors=True)
        os.replace(scratch, final)
    except Exception as error:  # Orbax and TensorStore wrap disk errors in many types
        shutil.rmtree(scratch, ignore_errors=True)
        raise RunError(f"the checkpoint of epoch {epoch} could not be written: {_reason(error)}") from error
    present = steps(directory)
    good = [step for step in present if step <= epoch]  # later steps are damaged, or the run would have resumed there
    for old in {*present} - {*kept(good)}:
        shutil.rmtree(directory / str(old), ignore_errors=True)


def kept(epochs: Sequence[int]) -> list[int]:
    """Selects the steps to keep from ascending ones: the newest two, and the first at or after each power of two.

    The latter are few: 7 of the 80 steps of 4,000 epochs.
    """
    first = {epoch.bit_length(): epoch for epoch in reversed(epochs)}
    return sorted({*epochs[-KEEP:], *first.values()})


def steps(directory: Path) -> list[int]:
    """Returns the epochs of all finished steps, ascending, including damaged ones."""
    if not directory.is_dir():
        return []
    named = (path for path in directory.iterdir() if path.name.isdecimal() and not path.is_symlink())
    return sorted(int(path.name) for path in named if path.is_dir())


def newest(directory: Path, warn: Callable[[str], None], until: int | None = None) -> Step | None:
    """Returns the newest undamaged step, or None if there are no steps.

    Args:
      directory: the run's `checkpoints`.
      warn: called with a line for each newer step that is damaged.
      until: leave out steps of later epochs.

    Raises:
      RunError: all steps are damaged.
    """
    faults: list[str] = []
    for epoch in reversed(steps(directory)):
        if until is not None and epoch > until:
            continue
        path = directory / str(epoch)
        fault = manifest.fault(path)
        if fault is None:
            for line in faults:
                warn(f"warning: {line}; going back to epoch {epoch}")
            return Step(epoch, path, _read_about(path))
        faults.append(f"{path} is damaged: {fault}")
    if faults:
        others = f", and {len(faults) - 1} older too" if len(faults) > 1 else ""
        raise RunError(f"{faults[0]}{others}; no good checkpoint is left (move {directory} away to start from scratch)")
    return None


def restore(step: Step, like: Any, partly: bool = False) -> Any:
    """Reads a step's state.

    Args:
      step: the step to read.
      like: the state's structure, of arrays or their shapes.
      partly: allow `like` to lack parts of the saved state, which are then not read.

    Returns:
      The state, on JAX's default device.

    Raises:
      RunError: the saved state has another structure, or cannot be read.
    """
    wanted = named_leaves(like)
    difference = first_difference(layout(wanted), step.about["leaves"], partly)
    if difference:
        raise RunError(f"{step.path} does not fit this run: {difference}")
    ocp = _orbax()
    arguments = {name: ocp.RestoreArgs(restore_type=np.ndarray) for name in wanted}
    request = ocp.args.PyTreeRestore(item=wanted, restore_args=arguments, partial_restore=partly)
    try:
        with ocp.Checkpointer(ocp.PyTreeCheckpointHandler()) as orbax:
            arrays = orbax.restore((step.path / "state").absolute(), request)
    except Exception as error:
        raise RunError(f"{step.path} cannot be read: {_reason(error)}") from error
    return rebuild(like, arrays)


def _read_about(path: Path) -> dict[str, Any]:
    about = json.loads((path / "about.json").read_text())
    if about.get("format") != FORMAT:
        raise RunError(f"{path} has format {about.get('format')}, but this version of ear_jax reads {FORMAT}")
    return about


def _reason(error: Exception) -> str:
    """Returns the system's message for an OS error, or the first line of any other."""
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    return (str(error).splitlines() or [type(error).__name__])[0]
