"""The point from which runs train on: their newest good steps, and directories prepared for it.

Of a run over several hosts process 0 reads and writes directories, and tells the others where training begins.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from ear_jax.config import Config
from ear_jax.errors import RunError, UsageError
from ear_jax.process import hosts
from ear_jax.runs import checkpoint, records
from ear_jax.runs.checkpoint import Step
from ear_jax.runs.directory import check_settings, check_tasks
from ear_jax.runs.documents import about, changed_code
from ear_jax.runs.failure import NAME, reported
from ear_jax.runs.history import FIRST, LOG, History, read_history, write_history
from ear_jax.runs.training import Program

Warn = Callable[[str], None]
NO_HISTORY = History(None, {}, "", 0.0, damaged=False)


@dataclass(frozen=True)
class Run:
    """A run to train."""

    config: Config
    directory: Path
    about: dict[str, Any] = field(default_factory=dict)  # the document of its config.json and checkpoints
    track: Callable[[list[dict[str, Any]]], None] = lambda _: None  # copies rows of metrics elsewhere
    rows: list[str] = field(default_factory=list)  # lines of its metrics.jsonl, to which training adds


@dataclass(frozen=True)
class Progress:
    """The point that runs training side by side have reached."""

    steps: list[Step]  # of each run, of one epoch; empty before the first
    epoch: int
    seconds: float  # trained until then
    histories: list[History] = field(default_factory=list)  # of each run; in process 0 only


def reached(runs: Sequence[Run], program: Program, warn: Warn) -> Progress:
    """Returns the newest good step of each run at the newest epoch of which all have one.

    A run that failed beside others stays as it is. Another run's step fills its place in the program.

    Raises:
      UsageError: a run was trained with other settings or tasks.
      RunError: one of them has lost its checkpoints, or all have failed.
    """
    failed = given_up(runs)
    going = [run for run, out in zip(runs, failed, strict=True) if not out]
    if not going:
        raise RunError(f"all {len(runs)} runs failed, see {runs[0].directory / NAME}")
    steps, until, histories = [], None, []
    while True:
        histories = [
            NO_HISTORY if out else read_history(run.directory, warn, until)
            for run, out in zip(runs, failed, strict=True)
        ]
        warn = ignore  # the same damage again
        steps = [history.step for history in histories if history.step]
        until = min((step.epoch for step in steps), default=0)
        if len(steps) < len(going) or all(step.epoch == until for step in steps):
            break
    if len(steps) < len(going):
        _check_first_save(going)
        steps, until = [], 0
    for run, history in zip(runs, histories, strict=True):
        if history.settings:
            _check_same(run.directory, history.settings, run.config, program)
        if history.step and steps:
            _check_same(history.step.path, history.step.about, run.config, program)
    if not steps:
        return Progress([], 0, 0.0, histories)
    seconds = max(history.seconds for history in histories)
    return Progress([history.step or steps[0] for history in histories], until, seconds, histories)


def given_up(runs: Sequence[Run]) -> list[bool]:
    """Tells of each run whether it failed while others trained beside it; such a run is neither saved nor recorded."""
    return [len(runs) > 1 and reported(run.directory) is not None for run in runs]


def agreed(find: Callable[[], Progress]) -> Progress:
    """Returns in every process the point that process 0 finds; raises what that raises."""
    found: list[Progress] = []

    def document() -> dict[str, Any]:
        progress = find()
        found.append(progress)
        steps = [{**asdict(step), "path": str(step.path)} for step in progress.steps] if hosts.count() > 1 else []
        return {"steps": steps, "epoch": progress.epoch, "seconds": progress.seconds}

    told = hosts.agree(document)
    if found:
        return found[0]
    steps = [Step(step["epoch"], Path(step["path"]), step["about"]) for step in told["steps"]]
    return Progress(steps, told["epoch"], told["seconds"])


def prepare(run: Run, program: Program, history: History, started: bool) -> Run:
    """Writes what the run's directory should hold before it trains on, and returns the run with its past.

    For a continued run config.json keeps what it tells of the start, and gets the settings, which may name more epochs.
    """
    document, past = about(program, run.config), history.settings
    document["run"] = past.get("run") or secrets.token_hex(8)
    first = past.get(FIRST) or history.step.epoch if started and history.step else None
    rows = history.rows if started else ""
    checkpoint.clean(run.directory / checkpoint.FOLDER)
    write_history(run.directory, {**document, **past, "config": document["config"], FIRST: first}, rows)
    return replace(run, about=document, rows=[rows])


def _check_first_save(runs: Sequence[Run]) -> None:
    """Raises RunError if one of the runs has lost its checkpoints, and was not killed as all were first saved."""
    saved = [(len(checkpoint.steps(run.directory / checkpoint.FOLDER)), run.directory) for run in runs]
    last = [records.read_rows(run.directory / LOG, ignore)[-1:] for run in runs]
    if max(saved)[0] > 1 or len({row[0]["epoch"] if row else 0 for row in last}) > 1:
        raise RunError(f"{min(saved)[1]} has no checkpoints, unlike {max(saved)[1]} that trained beside it")


def ignore(_: str) -> None:
    """Says nothing."""


def _check_same(holder: Path, document: dict[str, Any], config: Config, program: Program) -> None:
    check_settings(holder, document, config)
    check_tasks(holder, document, program.tasks)
    if changed := changed_code(holder, document, program):
        raise UsageError(f"{changed}; use another --out")
