"""Seconds, env steps and updates until a run's mean return first passed given marks, from its metrics alone.

    python -m benchmarks.time_to_return [RUN …]

RUN is a run directory; by default all committed records are read. A mark is passed when the mean of three evaluations
in a row reaches it, so that a single lucky evaluation does not count. Rows have the machine and commit of the run.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import common
from ear_jax.cli.exits import exit_code
from ear_jax.runs import records

RECORDS = common.RESULTS.parent.parent / "experiments" / "records"
MARKS: dict[str, tuple[float, ...]] = {  # the last mark of each family is the paper's return
    "halfcheetah-vel": (-350, -300, -250, -200, -170, -150, -136.9),
    "hopper-vel": (100, 120, 140, 160, 173.5),
    "walker-vel": (80, 100, 120, 155, 172.7),
    "ant-dir": (200, 400, 800, 900, 1216.7),
}
IN_A_ROW = 3


def passed(rows: list[dict[str, Any]], mark: float) -> dict[str, Any] | None:
    """Returns the metrics row of one seed at which the mark was first passed; None if it never was."""
    returns = np.array([row["mean_return"] for row in rows])
    for end in range(IN_A_ROW, len(rows) + 1):
        if returns[end - IN_A_ROW : end].mean() >= mark:
            return rows[end - 1]
    return None


def rows_of(run: Path) -> list[dict[str, Any]]:
    """Returns a row for each seed of a run and each mark of its family."""
    about = records.read_run(run)
    config, metrics = about["config"], records.read_rows(run / "metrics.jsonl")
    marks = []
    for seed in sorted({row["seed"] for row in metrics}):
        rows = [row for row in metrics if row["seed"] == seed]
        for mark in MARKS.get(config["family"], ()):
            at = passed(rows, mark)
            reached = {key: at[key] for key in ("seconds", "env_steps", "updates")} if at else {"passed": False}
            names = {key: config[key] for key in ("family", "agent", "preset")}
            best = round(max(row["mean_return"] for row in rows), 1)
            marks.append({**names, "seed": seed, "return": mark, **reached, "best": best, **_provenance(about)})
    return marks


def _provenance(about: dict[str, Any]) -> dict[str, Any]:
    return {key: about[key] for key in ("machine", "commit") if key in about}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("runs", nargs="*", type=Path, metavar="RUN")
    parser.add_argument("--results", type=Path, default=common.RESULTS, help="directory of the JSON lines files")
    options = parser.parse_args()
    rows = [row for run in options.runs or sorted(RECORDS.glob("[!.]*")) for row in rows_of(run)]
    path = options.results / "time_to_return.jsonl"
    records.write_text(path, "".join(json.dumps({"benchmark": "time_to_return", **row}) + "\n" for row in rows))
    print(path.read_text(), end="")


if __name__ == "__main__":
    sys.exit(exit_code("time_to_return", main))
