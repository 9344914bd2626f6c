"""Errors of `ear follow` on three profiles of the shipped cheetah and a square of the ant, and seconds of the command.

The command is run from the shell, in the current directory, once to survey the sphere and then twice for each course:
with a fresh cache of compiled programs (`first_seconds`), and with that cache. A row has what one way did.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from typing import Any

from benchmarks import common
from ear_jax.cli.exits import exit_code

CHEETAH, ANT = "pretrained:halfcheetah-vel", "pretrained:ant-dir"
COURSES = (
    (CHEETAH, "profile", "0:1, 3:6, 6:2"),
    (CHEETAH, "profile", "0:2, 4:8, 6:8, 8:3"),
    (CHEETAH, "profile", "0:3, 2:3, 2.5:5, 5:5, 5.5:1.5, 8:1.5"),
    (ANT, "path", "6 0, 6 6, 0 6, 0 0"),
)
EPISODES = {"profile": 5, "path": 100}


def follow(run: str, kind: str, course: str, cache: str, quick: bool) -> tuple[dict[str, Any], float]:
    """Runs the command and returns its document, and the seconds that it took."""
    words = ["follow", run, f"--{kind}", course, "--episodes", "2" if quick else str(EPISODES[kind]), "--no-film"]
    command = [sys.executable, "-m", "ear_jax.cli.main", *words, "--json", *(["--epochs", "1"] if quick else [])]
    began = time.perf_counter()
    environment = {**os.environ, "EAR_JAX_CACHE": cache}
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
    return json.loads(done.stdout), time.perf_counter() - began


def measure(options: argparse.Namespace, run: str, kind: str, course: str) -> None:
    """Runs the command with a fresh cache and again, and appends a row for each way."""
    with tempfile.TemporaryDirectory() as cache:
        document, first = follow(run, kind, course, cache, options.quick)
        _, again = follow(run, kind, course, cache, options.quick)
    seconds = {"first_seconds": round(first, 1), "seconds": round(again, 1)}
    for way, found in document["seeds"][0]["ways"].items():
        measured = {name: found[name] for name in ("error", "errors", "aside", "lasted", "turn") if name in found}
        steps = document["env_steps"] if way == "spline" else 0
        row = {"run": run, "course": course, "way": way, "unit": document["unit"], "env_steps": steps}
        common.write_row(options, "following", {**row, **measured, **seconds})


def main() -> None:
    options = common.arguments(__doc__)
    courses = COURSES[:1] if options.quick else COURSES
    with tempfile.TemporaryDirectory() as cache:
        for run, kind, course in {run: (run, *rest) for run, *rest in courses}.values():
            follow(run, kind, course, cache, quick=True)  # keeps a survey beside the run
    for run, kind, course in courses:
        measure(options, run, kind, course)


if __name__ == "__main__":
    sys.exit(exit_code("following", main))
