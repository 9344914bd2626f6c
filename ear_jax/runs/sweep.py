"""Sweeps: directories of runs that differ in some settings, and what came of each. Imports no JAX.

A sweep's directory holds `sweep.json` (the settings that vary, every trial and, at the end, its results) and a run
directory for each trial.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from statistics import mean, stdev
from typing import Any

from ear_jax.errors import RunError, UsageError
from ear_jax.runs import directory as directories
from ear_jax.runs import failure, records

NAME = "sweep.json"


def check_place(directory: Path) -> None:
    """Checks that a directory can hold a sweep; raises UsageError if it holds something else, RunError as a run's."""
    if (directory / NAME).exists():
        return
    if directory.is_dir() and not all(re.fullmatch(directories.UNSTARTED, path.name) for path in directory.iterdir()):
        raise UsageError(f"--out {directory} is neither empty nor a sweep's directory; name another")
    directories.check_place(directory)


def begin(directory: Path, family: str, trials: Mapping[str, Mapping[str, Any]]) -> None:
    """Makes a sweep's directory, or checks that it holds the same sweep.

    Args:
      directory: the sweep's.
      family: the family of tasks.
      trials: the settings of each trial, by the name of its directory.

    Raises:
      UsageError: the directory holds something else.
    """
    check_place(directory)
    if (directory / NAME).exists():
        before = read_sweep(directory)
        held = {trial["name"] for trial in before["trials"]}
        if before["family"] != family or held != set(trials):
            raise UsageError(f"{directory} holds a sweep of {len(held)} other trials; use another --out")
        return
    plan = [{"name": name, "settings": dict(settings)} for name, settings in trials.items()]
    records.write_json(directory / NAME, {"family": family, "trials": plan})


def read_sweep(directory: Path) -> dict[str, Any]:
    """Returns a sweep's document; raises RunError if it cannot be read."""
    document = records.read_json(directory / NAME)
    if "family" not in document or not isinstance(document.get("trials"), list):
        raise RunError(f"{directory / NAME} cannot be read: it names no family or no trials")
    return document


def describe(directory: Path) -> dict[str, Any]:
    """Returns a sweep's document with the results of its trials so far, the best first.

    A trial's `return` is the mean over seeds of its last evaluation, `deviation` the standard deviation between seeds,
    and `mean_over_run` the mean over all evaluations. `curve` has rows [updates, env steps, seconds, mean return].
    """
    document = read_sweep(directory)
    trials = [{**_trial(directory / trial["name"]), **_plan(trial)} for trial in document["trials"]]
    trials.sort(key=_rank)
    return {"family": document["family"], "trials": trials}


def _rank(trial: dict[str, Any]) -> tuple[bool, bool, float]:
    """Ranks trials: the highest return first, those without one after them, those that failed last."""
    return trial["failed"] is not None, trial["return"] is None, -(trial["return"] or 0.0)


def _plan(trial: dict[str, Any]) -> dict[str, Any]:
    return {"name": trial["name"], "settings": trial["settings"]}


def _trial(run: Path) -> dict[str, Any]:
    """Returns the results of one trial's run."""
    rows = records.read_rows(run / "metrics.jsonl", required=records.METRICS)
    epochs = sorted({row["epoch"] for row in rows})
    blocks = [[row for row in rows if row["epoch"] == epoch] for epoch in epochs]
    curve = [
        [*(block[0][name] for name in ("updates", "env_steps", "seconds")), mean(row["mean_return"] for row in block)]
        for block in blocks
    ]
    last = [row["mean_return"] for row in blocks[-1]] if blocks else []
    return {
        "return": mean(last) if last else None,
        "deviation": stdev(last) if len(last) > 1 else None,
        "mean_over_run": mean(point[3] for point in curve) if curve else None,
        "seeds": {str(row["seed"]): row["mean_return"] for row in blocks[-1]} if blocks else {},
        "failed": failure.reported(run),
        "curve": curve,
    }
