"""Saving and restoring training states through Orbax, which only this module calls.

A step is a directory named by its epoch. It holds Orbax's `state/`, `about.json` (the run, the epoch and the layout of
its state), the run's rows of metrics until then, and a manifest of checksums. It is written under a temporary name and
then renamed, so a step is complete or absent. The newest good step is found by listing the directory and verifying
checksums.
"""

from __future__ import annotations

import contextlib
import functools
import logging
import os
import re
import shutil
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np

from ear_jax.errors import RunError
from ear_jax.process import hosts
from ear_jax.runs import manifest, records
from ear_jax.runs.directory import FOLDER, steps
from ear_jax.runs.leaves import first_difference, layout, named_leaves, rebuild
from ear_jax.runs.seeds import own_members


@functools.cache
def _orbax() -> Any:
    """Returns Orbax, which takes a second to import and which an exported file does without.

    Orbax closes its event loop at the first failed write. Each pending write of TensorStore then fails with "Event loop
    is closed", whenever it is collected; that is not reported.
    """
    import orbax.checkpoint

    report = sys.unraisablehook

    def report_others(unraisable: sys.UnraisableHookArgs) -> None:
        if str(unraisable.exc_value) != "Event loop is closed":
            report(unraisable)

    sys.unraisablehook = report_others
    return orbax.checkpoint


@contextlib.contextmanager
def _checkpointer(ocp: Any) -> Iterator[Any]:
    """A context with what saves and restores; the processes of a run wait for each other through JAX's service."""
    together = set(range(hosts.count())) if hosts.count() > 1 else None
    options = ocp.options.MultiprocessingOptions(primary_host=0, active_processes=together)
    handler = ocp.PyTreeCheckpointHandler(multiprocessing_options=options)
    logger = logging.getLogger("absl")  # Orbax logs every save; failures are also raised
    level = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        with ocp.Checkpointer(handler, multiprocessing_options=options) as checkpointer:
            yield checkpointer
    finally:
        logger.setLevel(level)


__all__ = ["FOLDER", "steps"]  # used as `checkpoint.…`
FORMAT = 1
KEEP = 2  # number of newest steps to keep
REMOVALS = 20  # number of attempts to remove a directory
ROWS = "metrics.jsonl"


@dataclass(frozen=True)
class Step:
    """A step whose checksums hold."""

    epoch: int
    path: Path
    about: dict[str, Any]  # the `about` given to `save`, and the state's layout

    @property
    def rows(self) -> str | None:
        """The lines of the run's metrics until this step; None in steps of earlier versions."""
        path = self.path / ROWS
        return path.read_text(encoding="utf-8") if path.exists() else None


def save(directory: Path, epoch: int, state: Any, about: dict[str, Any], rows: str = "") -> None:
    """Writes a step atomically, then deletes the steps that need not be kept.

    Of a run over several hosts each writes its seeds, and process 0 the rest.

    Args:
      directory: the run's `checkpoints`.
      epoch: the step's name.
      state: any pytree of arrays, including random keys.
      about: a JSON document that describes the run.
      rows: the lines of its metrics so far.

    Raises:
      RunError: the step could not be written; earlier steps are unchanged.
    """
    scratch, leaves = directory / f".{epoch}.part", named_leaves(state)
    document = {**about, "format": FORMAT, "epoch": epoch, "leaves": layout(leaves)}
    try:
        hosts.agree(lambda: _begin(directory, scratch))
        ocp = _orbax()
        with _checkpointer(ocp) as orbax:
            orbax.save((scratch / "state").absolute(), leaves)
        hosts.agree(lambda: _end(scratch, directory / str(epoch), document, rows))
    except Exception as error:  # Orbax and TensorStore wrap disk errors in many types
        hosts.settle()
        if hosts.index() == 0:
            shutil.rmtree(scratch, ignore_errors=True)
        raise RunError(f"the checkpoint of epoch {epoch} could not be written: {_reason(error)}") from error
    if hosts.index() == 0:
        _remove_old(directory, epoch)


def _begin(directory: Path, scratch: Path) -> None:
    clean(directory)
    scratch.mkdir(parents=True)


def _end(scratch: Path, final: Path, document: dict[str, Any], rows: str) -> None:
    """Completes a step whose arrays are written, and gives it its name."""
    records.write_json(scratch / "about.json", document)
    if rows:
        records.write_text(scratch / ROWS, rows)
    manifest.write(scratch)
    _remove(final)
    os.replace(scratch, final)


def _remove_old(directory: Path, epoch: int) -> None:
    """Deletes the steps that need not be kept after that of an epoch."""
    present = steps(directory)
    good = [step for step in present if step <= epoch]  # later steps are damaged, or the run would have resumed there
    for old in {*present} - {*kept(good)}:
        with contextlib.suppress(OSError):
            _remove(directory / str(old))


def clean(directory: Path) -> None:
    """Removes what killed processes left in a run's `checkpoints`, of whatever type; raises RunError if that fails."""
    try:
        for path in directory.iterdir() if directory.is_dir() else ():
            if re.fullmatch(r"\..*\.(part|old)", path.name):
                _remove(path)
    except OSError as error:
        raise RunError(f"cannot remove {error.filename}: {error.strerror}") from None


def _remove(path: Path) -> None:
    """Removes a file, a link or a directory, if there is one; its name is gone before the files in it are.

    A process that reads a step meanwhile then sees that it is gone, and does not take it for damaged.
    """
    aside = path if path.name.startswith(".") else path.with_name(f".{path.name}.old")
    if aside != path and os.path.lexists(path):
        _remove(aside)
        os.replace(path, aside)
    if aside.is_dir() and not aside.is_symlink():
        _remove_tree(aside)
    else:
        aside.unlink(missing_ok=True)


def _remove_tree(path: Path) -> None:
    """Removes a directory, to which writes that Orbax abandoned in this process may add files for a while."""
    for attempt in range(1, REMOVALS + 1):
        shutil.rmtree(path, ignore_errors=attempt < REMOVALS)
        if not path.exists():
            return
        time.sleep(0.05)


def kept(epochs: Sequence[int]) -> list[int]:
    """Selects the steps to keep from ascending ones: the newest two, and the first at or after each power of two.

    The latter are few: 7 of the 80 steps of 4,000 epochs.
    """
    first = {epoch.bit_length(): epoch for epoch in reversed(epochs)}
    return sorted({*epochs[-KEEP:], *first.values()})


def newest(
    directory: Path, warn: Callable[[str], None], until: int | None = None, run: str | None = None
) -> Step | None:
    """Returns the newest undamaged step, or None if there are no steps.

    Args:
      directory: the run's `checkpoints`.
      warn: called with a line for each newer step that is damaged, or is not what its name and place say.
      until: leave out steps of later epochs.
      run: the identifier of the run, if it is known; steps of another run count as damaged.

    Raises:
      RunError: all steps are damaged.
    """
    faults: list[str] = []
    for epoch in reversed(steps(directory)):
        if until is not None and epoch > until:
            continue
        path = directory / str(epoch)
        try:
            step = _read_step(path, epoch, run)
        except _Fault as fault:
            if not path.exists():  # a process that trains has removed it since it was listed
                return newest(directory, warn, until, run)
            faults.append(f"{path} is damaged: {fault}")
            continue
        for line in faults:
            warn(f"warning: {line}; going back to epoch {epoch}")
        return step
    if faults:
        others = f", and {len(faults) - 1} older too" if len(faults) > 1 else ""
        raise RunError(f"{faults[0]}{others}; no good checkpoint is left (move {directory} away to start from scratch)")
    return None


def restore(step: Step, like: Any, partly: bool = False, sharding: jax.sharding.Sharding | None = None) -> Any:
    """Reads a step's state.

    Args:
      step: the step to read.
      like: the state's structure, of arrays or their shapes.
      partly: allow `like` to lack parts of the saved state, which are then not read.
      sharding: of all leaves over the devices of several hosts; each host reads its part.

    Returns:
      The state, on JAX's default device or as `sharding` says.

    Raises:
      RunError: the saved state has another structure, has counters that make no sense, or cannot be read.
    """
    wanted = named_leaves(like)
    difference = first_difference(layout(wanted), step.about["leaves"], partly)
    if difference:
        raise RunError(f"{step.path} does not fit this run: {difference}")
    ocp = _orbax()
    whole, parts = ocp.RestoreArgs(restore_type=np.ndarray), ocp.ArrayRestoreArgs(sharding=sharding)
    arguments = dict.fromkeys(wanted, parts if sharding else whole)
    request = ocp.args.PyTreeRestore(item=wanted, restore_args=arguments, partial_restore=partly)
    try:
        with _checkpointer(ocp) as orbax:
            arrays = orbax.restore((step.path / "state").absolute(), request)
    except Exception as error:
        hosts.settle()
        raise RunError(f"{step.path} cannot be read: {_reason(error)}") from error
    _check_counters(step, own_members(arrays))
    return rebuild(like, arrays)


def _check_counters(step: Step, arrays: Mapping[str, np.ndarray]) -> None:
    """Raises RunError if a number that only counts is negative, or is not what the step's epoch makes of it."""
    for name, array in arrays.items():
        if array.size and np.issubdtype(array.dtype, np.signedinteger):
            low, high = array.min(), array.max()
            least = step.epoch if name in ("epoch", "collected") else 0
            if low < least or (name == "epoch" and high != step.epoch):
                wrong = f"{name} is {low if low < least else high}"
                raise RunError(f"{step.path} is not the state of a run at epoch {step.epoch}: {wrong}")


class _Fault(Exception):
    """A step is damaged, or is not what its name and place say."""


def _read_step(path: Path, epoch: int, run: str | None) -> Step:
    fault = manifest.fault(path)
    if fault is not None:
        raise _Fault(fault)
    try:
        about = records.read_json(path / "about.json")
    except RunError as error:
        raise _Fault(error) from None
    if about.get("format") != FORMAT:
        raise RunError(f"{path} has format {about.get('format')}, but this version of ear_jax reads {FORMAT}")
    if about.get("epoch") != epoch:
        raise _Fault(f"it is the checkpoint of epoch {about.get('epoch')}")
    if run is not None and about.get("run", run) != run:  # steps of earlier versions do not name their run
        raise _Fault("it is the checkpoint of another run")
    if not isinstance(about.get("leaves"), dict):
        raise _Fault("about.json does not list its arrays")
    return Step(epoch, path, about)


def _reason(error: Exception) -> str:
    """Returns the system's message for an OS error, or the first line of any other."""
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    return (str(error).splitlines() or [type(error).__name__])[0]
