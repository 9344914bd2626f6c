"""A run's `config.json` and `metrics.jsonl`, held against its newest good step, which can replace them.

A step is checksummed as a whole and holds the same facts. So a document that is lost or damaged is restored from it,
with a warning; and rows without any step are a history that a new start would erase, so that is refused.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Any

from ear_jax.errors import RunError
from ear_jax.files.rows import lines_of
from ear_jax.runs import checkpoint, records
from ear_jax.runs.checkpoint import Step

LOG = "metrics.jsonl"
FIRST = "first_checkpoint"  # in config.json: the epoch of the first step; None before it, absent in earlier versions
OF_STEPS = ("format", "epoch", "leaves")  # keys of a step's description that config.json lacks


@dataclass(frozen=True)
class History:
    """A run's past, as its directory should tell it."""

    step: Step | None  # the newest good one
    settings: dict[str, Any]  # of config.json; empty before the first start
    rows: str  # the lines of metrics.jsonl until the step
    seconds: float  # trained until then
    damaged: bool  # the directory tells something else


def read_history(directory: Path, warn: Callable[[str], None], until: int | None = None) -> History:
    """Reads a run's past.

    Args:
      directory: the run's; it may be empty or missing.
      warn: called with a line for each step, document or row that is damaged.
      until: leave out steps of later epochs.

    Raises:
      RunError: no good step is left, though there were some.
    """
    settings, fault = _read_settings(directory)
    step = checkpoint.newest(directory / checkpoint.FOLDER, warn, until, settings.get("run"))
    if step is None:
        if until is None:
            _check_nothing_is_lost(directory, settings, fault)
        return History(None, settings, "", 0.0, damaged=False)
    if fault:
        warn(f"warning: {fault}; its settings are those of the checkpoint of epoch {step.epoch}")
        settings = {name: value for name, value in step.about.items() if name not in OF_STEPS}
        settings[FIRST] = min(checkpoint.steps(directory / checkpoint.FOLDER))
    rows, complete = _rows(directory / LOG, step, warn)
    parsed = [row for _, row in lines_of(rows, directory / LOG, lambda _: None, records.METRICS) if row]
    seconds = max((row["seconds"] for row in parsed), default=0.0)
    return History(step, settings, rows, seconds, damaged=bool(fault) or not complete)


def read_step(directory: Path, warn: Callable[[str], None]) -> Step:
    """Returns a run's newest good step; raises UsageError if there is no run, RunError if no good step is left."""
    settings, fault = _read_settings(directory)
    step = checkpoint.newest(directory / checkpoint.FOLDER, warn, run=settings.get("run"))
    if step is None:
        records.read_run(directory)
        _check_nothing_is_lost(directory, settings, fault)
        raise RunError(f"{directory} has no checkpoint yet; the same `ear train` command continues it")
    if fault:
        warn(f"warning: {fault}; `ear train` restores it from the checkpoint of epoch {step.epoch}")
    return step


def write_history(directory: Path, settings: dict[str, Any], rows: str) -> None:
    """Writes a run's documents where they differ; raises RunError if they cannot be written."""
    if _read_settings(directory)[0] != settings:
        records.write_json(directory / "config.json", settings)
    if _text(directory / LOG) != rows:
        records.write_text(directory / LOG, rows)


def note_first_step(directory: Path, epoch: int) -> None:
    """Writes the epoch of a run's first step into its config.json; raises RunError if it cannot be written."""
    settings, fault = _read_settings(directory)
    if not fault and settings.get(FIRST) is None:
        records.write_json(directory / "config.json", {**settings, FIRST: epoch})


def _read_settings(directory: Path) -> tuple[dict[str, Any], str | None]:
    """Returns config.json and None, or nothing and what is wrong with it."""
    path = directory / "config.json"
    if not path.is_file():
        return {}, f"{path} is missing"
    try:
        return records.read_run(directory), None
    except RunError as error:
        return {}, str(error)


def _check_nothing_is_lost(directory: Path, settings: dict[str, Any], fault: str | None) -> None:
    """Raises RunError if a run without a step has rows, unless it was killed before its first step."""
    rows = records.read_rows(directory / LOG, lambda _: None)
    if rows and settings.get(FIRST, "unknown") is not None:
        had = f", though one was saved at epoch {settings[FIRST]}" if FIRST in settings else ""
        raise RunError(
            f"{directory} has lost its {checkpoint.FOLDER}: {f'{fault}, and ' if fault else ''}it has rows of metrics "
            f"until epoch {rows[-1].get('epoch')}, but no checkpoint{had}; nothing was changed: put them back (is a "
            "disk not mounted?), or name another --out to start anew"
        )


def _rows(log: Path, step: Step, warn: Callable[[str], None]) -> tuple[str, bool]:
    """Returns the lines of a run's metrics until a step, and whether the file has them all."""
    text = _text(log)
    if step.rows is None:
        lines = list(lines_of(text, log, warn, records.METRICS))
        until = [number for number, (_, row) in enumerate(lines, start=1) if row and row["epoch"] <= step.epoch]
        return "".join(line for line, _ in lines[: max(until, default=0)]), True  # a damaged line is left as it is
    if text.startswith(step.rows):
        return step.rows, text == step.rows  # further rows are of epochs that no step has
    pairs = enumerate(zip_longest(text.split("\n"), step.rows.split("\n")), start=1)
    first = next(number for number, (one, other) in pairs if one != other)
    warn(f"warning: {log} is damaged in line {first}; its rows are those of the checkpoint of epoch {step.epoch}")
    return step.rows, False


def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8", errors="replace") if path.exists() else ""
