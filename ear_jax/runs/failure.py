"""Numbers that went bad: a run stops at the first that is not finite, and leaves a report of where and what."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from ear_jax.errors import RunError
from ear_jax.runs import records

NAME = "failure.json"


def check_finite(directory: Path, rows: list[dict[str, Any]], finite: np.ndarray, before: int) -> None:
    """Refuses to go on from a block in which a number was not finite.

    Args:
      directory: the run's, where the report is left.
      rows: the block's metrics, a row a seed.
      finite: [seeds, tasks], the block's updates before a task's loss was first not finite.
      before: updates before the block.

    Raises:
      RunError: what was not finite, where, and which report tells more.
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
        raise RunError(
            f"seed {row['seed']} is lost: {bad[0]} is {numbers[bad[0]]} after {report['finite_updates']:,} updates "
            f"({tasks}); checkpoints are as they were, and the same command would end the same; see {directory / NAME}"
        )


def _numbers(row: dict[str, Any]) -> list[tuple[str, float]]:
    returns = [(f"return of {task}", value) for task, value in row["returns"].items()]
    return [(name, value) for name, value in row.items() if isinstance(value, float)] + returns


def _last_row(directory: Path, seed: int) -> dict[str, Any] | None:
    rows = [row for row in records.read_rows(directory / "metrics.jsonl") if row["seed"] == seed]
    return rows[-1] if rows else None
