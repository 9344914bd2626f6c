"""Made-up records for tests of the report, and readers of its Markdown."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

from ear_jax.config import Config
from ear_jax.presets import preset_config
from ear_jax.runs import records
from experiments import inventory
from experiments.paper import EXPERIMENTS
from experiments.report import comparison, markdown, sections
from experiments.report.run_index import RunIndex

MADE = {"machine": {"processor": "Z80", "cores": 1}, "versions": {}, "commit": "c0ffee"}
SPEEDS = [float(speed) for speed in range(1, 11)]


def record(
    family: str = "halfcheetah-vel",
    agent: str = "ear",
    preset: str = "fast",
    seed: int = 0,
    level: float = -200,
    **made: Any,
) -> Path:
    """Writes a record of two rows whose tasks return `level`, `level` + 1, …, over at least 400 epochs."""
    config = dataclasses.replace(preset_config(family, preset, agent), seed=seed, **made)
    directory = inventory.RECORDS / f"{family}-{agent}-{preset}-seed{seed}"
    directory.mkdir(parents=True)
    tasks = [{"name": f"vel-{speed:g}", "target": speed, "params": {}} for speed in SPEEDS]
    records.write_json(directory / "config.json", {"config": dataclasses.asdict(config), "tasks": tasks, **MADE})
    returns = {task["name"]: level + index for index, task in enumerate(tasks)}
    for epoch in (10, max(400, config.epochs)):
        row = {"seed": seed, "epoch": epoch, "env_steps": 2000 * epoch, "updates": 200 * epoch, "seconds": 6.0 * epoch}
        records.append_rows(directory / "metrics.jsonl", [{**row, "mean_return": level + 4.5, "returns": returns}])
    return directory


def add(directory: Path, name: str, **document: Any) -> None:
    records.write_json(directory / f"{name}.json", {**document, **MADE, "command": f"ear {name}"})


def add_pairs(directory: Path, seed: int, successes: int) -> None:
    """Adds nine pairs: `successes` meet the value midway, one fewer again and between at β = ½."""
    pairs = [
        {
            "seed": seed,
            "between": [f"vel-{one:g}", f"vel-{one + 1:g}"],
            "target": one + 0.5,
            "beta": 0.4,
            "outcome": one + 0.51,
            "mid_task": index < successes,
            "fresh": index < successes - 1,
            "fresh_outcome": one + 0.52,
            "one_to_one": index < successes - 1,
            "one_to_one_outcome": one + 0.6 + 0.1 * seed,
        }
        for index, one in enumerate(SPEEDS[:-1])
    ]
    add(directory, "interpolation", pairs=pairs)


def section(id: str, out: Path, preset: str = "fast") -> str:
    """Returns one section as Markdown."""
    found = RunIndex(preset)
    whole = {"comparison": comparison.comparison, "runs": sections.all_runs}
    one = whole[id](found) if id in whole else sections.section(EXPERIMENTS[id], found, out)
    return markdown.document("", [], [one])


def cells(text: str, row: str) -> list[str]:
    """Returns the cells of the first table row that begins with `row`."""
    line = next(line for line in text.splitlines() if line.startswith(f"| {row} |"))
    return [cell.strip() for cell in line.strip("|").split("|")]


def write_run(directory: Path, config: Config, **row: float) -> None:
    """Writes a run's configuration and one row."""
    directory.mkdir(parents=True, exist_ok=True)
    records.write_json(directory / "config.json", {"config": dataclasses.asdict(config)})
    (directory / "metrics.jsonl").write_text(json.dumps({"epoch": config.epochs, "seconds": 60.0, **row}) + "\n")
