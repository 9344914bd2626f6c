"""Wall time from the command to the first row of metrics, with a cold and a warm compilation cache, and of imports.

Every measurement uses a fresh process. A phase ends when `ear train` prints it on stderr; the last phase ends with the
first row on the disk, after one epoch and one evaluation.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

from benchmarks import common
from ear_jax.cli.exits import exit_code

IMPORTS = ("ear_jax", "jax", "ear_jax.runs.loop", "ear_jax.cli.train")
# Beginning of a line of `ear train` → the phase that ends with it.
PHASES = {"halfcheetah-vel ·": "setup", "compiling:": "compile", "collecting": "pretrain", "epoch ": "first_block"}
QUICK = ("--collect.pretrain-epochs", "1", "--sac.updates", "5", "--log.episodes", "1")


def import_seconds(module: str) -> float:
    """Returns the seconds of an import in a fresh interpreter, without the interpreter's start."""
    code = f"import time; began = time.perf_counter(); import {module}; print(time.perf_counter() - began)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return float(done.stdout.splitlines()[-1])


def first_row_seconds(cache: Path, settings: tuple[str, ...]) -> dict[str, float]:
    """Trains for one epoch; returns seconds by phase, before training, to the first row (`total`) and to the exit."""
    with tempfile.TemporaryDirectory() as scratch:
        run = Path(scratch) / "run"
        words = ("train", "halfcheetah-vel", "--epochs", "1", "--log.epochs", "1", "--out", str(run), *settings)
        environment = {name: value for name, value in os.environ.items() if name != "JAX_COMPILATION_CACHE_DIR"}
        environment["EAR_JAX_CACHE"] = str(cache)
        began = time.perf_counter()
        process = subprocess.Popen(
            [sys.executable, "-m", "ear_jax.cli.main", *words], env=environment, stderr=subprocess.PIPE, text=True
        )
        lines: list[tuple[float, str]] = []  # seconds since the command, and the line
        reader = threading.Thread(target=lambda: lines.extend((time.perf_counter() - began, x) for x in process.stderr))
        reader.start()
        total = _wait_for_row(process, run / "metrics.jsonl", began)
        code = process.wait()
        ended = time.perf_counter() - began
        reader.join()
    if code or total is None:
        raise RuntimeError(f"ear train failed ({code}): " + "".join(line for _, line in lines))
    phases = _phases(lines, total)
    return {**phases, "before_training": total - phases["first_block"], "total": total, "exit": ended}


def _wait_for_row(process: subprocess.Popen, path: Path, began: float) -> float | None:
    """Returns the seconds until the row was on the disk, to 5 ms; None if the process ended without one."""
    while True:
        ended = process.poll() is not None
        if path.exists() and path.stat().st_size:
            return time.perf_counter() - began
        if ended:
            return None
        time.sleep(0.005)


def _phases(lines: list[tuple[float, str]], total: float) -> dict[str, float]:
    """Returns the duration of each phase, from the times at which phases ended."""
    phases, before = {}, 0.0
    for start, phase in PHASES.items():
        ends = [total] if phase == "first_block" else [when for when, line in lines if line.startswith(start)]
        if ends:
            phases[phase], before = ends[0] - before, ends[0]
    return phases


def measure_imports(options: argparse.Namespace, repeats: int) -> None:
    seconds: dict[str, list[float]] = {module: [] for module in IMPORTS}
    for _ in range(repeats):
        for module in IMPORTS:
            seconds[module].append(import_seconds(module))
    for module, elapsed in seconds.items():
        row = {"what": "import", "module": module, "repeats": repeats, **common.spread("seconds", elapsed)}
        common.write_row(options, "startup", row)


def measure_training(options: argparse.Namespace, repeats: int) -> None:
    """Times cold and warm runs in turn: each cold run fills the cache for the warm run after it."""
    settings = ("--preset", "fast", *(QUICK if options.quick else ()))
    runs: dict[str, list[dict[str, float]]] = {"cold": [], "warm": []}
    for _ in range(repeats):
        with tempfile.TemporaryDirectory() as cache:
            for kind in runs:
                runs[kind].append(first_row_seconds(Path(cache), settings))
    for kind, timings in runs.items():
        row: dict[str, Any] = {"what": "first_row", "preset": "fast", "cache": kind, "repeats": repeats}
        for name in timings[0]:
            row.update(common.spread(f"{name}_seconds", [run[name] for run in timings]))
        common.write_row(options, "startup", row)


def main() -> None:
    options = common.arguments(__doc__)
    measure_imports(options, 1 if options.quick else 5)
    measure_training(options, 1 if options.quick else 3)


if __name__ == "__main__":
    sys.exit(exit_code("startup", main))
