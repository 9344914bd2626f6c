"""Directories of runs with made-up records, without training."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

from ear_jax.config import Config
from ear_jax.runs import records


def write_records(path: Path, returns: dict[int, list[dict[str, float]]], **settings: Any) -> Path:
    """Writes the settings and metrics of a run of HalfCheetah-Vel.

    Args:
      path: the directory.
      returns: seed → of each row the return of each task; rows are 10 epochs, 400 updates and half a minute apart.
      **settings: settings of `Config`.
    """
    config = Config("halfcheetah-vel", seed=min(returns), seeds=len(returns), **settings)
    records.write_json(path / "config.json", {"config": dataclasses.asdict(config)})
    for seed, rows in returns.items():
        for index, by_task in enumerate(rows, 1):
            row = {
                "seed": seed,
                "epoch": 10 * index,
                "env_steps": 1000 * index,
                "updates": 400 * index,
                "seconds": 30.0 * index,
                "mean_return": sum(by_task.values()) / len(by_task),
                "returns": by_task,
                "entropy": -6.0,
            }
            records.append_rows(path / "metrics.jsonl", [row])
    return path
