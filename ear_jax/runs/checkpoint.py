"""Saving and restoring whole training states through Orbax. The only module that calls it.

A step is a directory named by its epoch: `state/`, Orbax's; `about.json`, what the run is and what the state holds; and
a manifest of checksums over both. It is written beside its place and then given its name, so it is there whole or not
at all; which step is the newest good one is found by looking.
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
import orbax.checkpoint as ocp

from ear_jax.errors import RunError
from ear_jax.runs import manifest, records
from ear_jax.runs.leaves import first_difference, layout, named_leaves, rebuild

logging.getLogger("absl").setLevel(logging.CRITICAL)  # Orbax narrates every save; what fails it raises too
_say_unraisable = sys.unraisablehook


def _but_stray_writes(unraisable: sys.UnraisableHookArgs) -> None:
    """Says that an exception could not be raised, as before, but for one.

    Orbax gives up at the first write that fails and closes its event loop, and each of TensorStore's writes that are
    still under way complains of that.
    """
    if str(unraisable.exc_value) != "Event loop is closed":
        _say_unraisable(unraisable)


sys.unraisablehook = _but_stray_writes

FORMAT = 1
KEEP = 2  # newest steps kept


@dataclass(frozen=True)
class Step:
    """A step found whole."""

    epoch: int
    path: Path
    about: dict[str, Any]  # what `save` was told, and the state's layout


def save(directory: Path, epoch: int, state: Any, about: dict[str, Any]) -> None:
    """Writes a step, whole or not at all, and then drops those that are no longer kept.

    Args:
      directory: the run's `checkpoints`.
      epoch: the step's name.
      state: any pytree of arrays, random keys included.
      about: what else to know of it, as JSON holds it.

    Raises:
      RunError: it could not be written; the steps before are as they were.
    """
    final, scratch = directory / str(epoch), directory / f".{epoch}.part"
    leaves = named_leaves(state)
    try:
        directory.mkdir(parents=True, exist_ok=True)
        for torn in directory.glob(".*.part"):  # of processes that were killed
            shutil.rmtree(torn)
        scratch.mkdir()
        with ocp.Checkpointer(ocp.PyTreeCheckpointHandler()) as orbax:
            orbax.save((scratch / "state").absolute(), leaves)
        document = {**about, "format": FORMAT, "epoch": epoch, "leaves": layout(leaves)}
        records.write_json(scratch / "about.json", document)
        manifest.write(scratch)
        shutil.rmtree(final, ignore_errors=True)
        os.replace(scratch, final)
    except Exception as error:  # Orbax and TensorStore raise whatever the disk's trouble becomes on its way up
        shutil.rmtree(scratch, ignore_errors=True)
        raise RunError(f"the checkpoint of epoch {epoch} could not be written: {_reason(error)}") from error
    found = steps(directory)
    good = [step for step in found if step <= epoch]  # a run goes on from its newest good step: later ones are damaged
    for old in {*found} - {*kept(good)}:
        shutil.rmtree(directory / str(old), ignore_errors=True)


def kept(epochs: Sequence[int]) -> list[int]:
    """Of ascending steps those to keep: the newest two, and for ever the first past every doubling of the epochs.

    The latter are few enough, 7 of the 80 that 4,000 epochs save.
    """
    first = {epoch.bit_length(): epoch for epoch in reversed(epochs)}
    return sorted({*epochs[-KEEP:], *first.values()})


def steps(directory: Path) -> list[int]:
    """The epochs of the finished steps, ascending, good or not."""
    if not directory.is_dir():
        return []
    found = (path for path in directory.iterdir() if path.name.isdecimal() and not path.is_symlink())
    return sorted(int(path.name) for path in found if path.is_dir())


def newest(directory: Path, warn: Callable[[str], None]) -> Step | None:
    """The newest step that is whole, or None where there are no steps.

    Args:
      directory: the run's `checkpoints`.
      warn: told of each newer step that is damaged, and what it is that is wrong with it.

    Raises:
      RunError: there are steps, and all of them are damaged.
    """
    faults: list[str] = []
    for epoch in reversed(steps(directory)):
        path = directory / str(epoch)
        fault = manifest.fault(path)
        if fault is None:
            for line in faults:
                warn(f"warning: {line}; going back to epoch {epoch}")
            return Step(epoch, path, _read_about(path))
        faults.append(f"{path} is damaged: {fault}")
    if faults:
        others = f", and {len(faults) - 1} older with it" if len(faults) > 1 else ""
        raise RunError(f"{faults[0]}{others}; no good checkpoint is left (move {directory} away to start anew)")
    return None


def restore(step: Step, like: Any, partly: bool = False) -> Any:
    """Reads a step.

    Args:
      step: which.
      like: the state's structure, of arrays or their shapes.
      partly: `like` may lack parts of what was saved, which are then not read.

    Returns:
      The state, on JAX's default device.

    Raises:
      RunError: it holds something else.
    """
    wanted = named_leaves(like)
    difference = first_difference(layout(wanted), step.about["leaves"], partly)
    if difference:
        raise RunError(f"{step.path} does not fit this run: {difference}")
    arguments = {name: ocp.RestoreArgs(restore_type=np.ndarray) for name in wanted}
    request = ocp.args.PyTreeRestore(item=wanted, restore_args=arguments, partial_restore=partly)
    try:
        with ocp.Checkpointer(ocp.PyTreeCheckpointHandler()) as orbax:
            found = orbax.restore((step.path / "state").absolute(), request)
    except Exception as error:
        raise RunError(f"{step.path} cannot be read: {_reason(error)}") from error
    return rebuild(like, found)


def _read_about(path: Path) -> dict[str, Any]:
    about = json.loads((path / "about.json").read_text())
    if about.get("format") != FORMAT:
        raise RunError(f"{path} has format {about.get('format')}, and this version of ear_jax reads {FORMAT}")
    return about


def _reason(error: Exception) -> str:
    """What the system said, out of what became of it on its way up."""
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    return (str(error).splitlines() or [type(error).__name__])[0]
