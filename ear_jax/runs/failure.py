"""Numbers that are not finite: a run ends at the first one and leaves a report."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from ear_jax.errors import RunError
from ear_jax.runs import records

NAME = "failure.json"


class Diverged(RunError):
    """Numbers of a run, or of all that trained side by side, are not finite."""


def reported(directory: Path) -> str | None:
    """Returns the metric that a run's report names, or None if the run has left no report; raises RunError."""
    path = directory / NAME
    if not path.exists():
        return None
    metrics = records.read_json(path).get("not_finite")
    if not (isinstance(metrics, list) and metrics and isinstance(metrics[0], str)):
        raise RunError(f"{path} names no metric; it is damaged")
    return metrics[0]


def forget(directory: Path) -> None:
    """Removes a run's report, as the run is tried again."""
    (directory / NAME).unlink(missing_ok=True)


def find_failure(directory: Path, rows: list[dict[str, Any]], finite: np.ndarray, before: int) -> str | None:
    """Reports the first metric of a run's last block that is not finite.

    Args:
      directory: the run's, where the report is written.
      rows: the block's metrics, one row per seed.
      finite: [seeds, tasks], the block's updates before a task's first non-finite loss.
      before: updates before the block.

    Returns:
      A line that names the metric, the tasks and the report; None if all metrics are finite.
    """
    for row, counts in zip(rows, finite, strict=True):
        numbers = dict(_numbers(row))
        bad = [name for name, value in numbers.items() if not math.isfinite(value)]
        if not bad:
            continue
        first = [name for name, count in zip(row["returns"], counts, strict=True) if count == counts.min()]
        report = {
            "seed": row["seed"],
            "block_ends_at_epoch": row["epoch"],
            "finite_updates": before + int(counts.min()),
            "tasks": first,
            "not_finite": bad,
            "norms": {name: str(value) for name, value in numbers.items() if name.endswith("_norm")},
            "last_finite_row": _last_row(directory, row["seed"]),
        }
        records.write_json(directory / NAME, report)
        tasks = f"task {first[0]}" if len(first) == 1 else f"{len(first)} tasks"
        return (
            f"seed {row['seed']} failed: {bad[0]} is {numbers[bad[0]]} after {report['finite_updates']:,} updates "
            f"({tasks}); see {directory / NAME}"
        )
    return None


def _numbers(row: dict[str, Any]) -> list[tuple[str, float]]:
    returns = [(f"return of {task}", value) for task, value in row["returns"].items()]
    return [(name, value) for name, value in row.items() if isinstance(value, float)] + returns


def _last_row(directory: Path, seed: int) -> dict[str, Any] | None:
    rows = [row for row in records.read_rows(directory / "metrics.jsonl", lambda _: None) if row["seed"] == seed]
    return rows[-1] if rows else None
