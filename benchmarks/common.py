"""What the benchmarks share: alternatives timed in turn, and rows with where they were measured. Imports no JAX."""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ear_jax.runs import records

RESULTS = Path(__file__).resolve().parent / "results"


def arguments(documentation: str | None) -> argparse.Namespace:
    """The command line every benchmark has."""
    parser = argparse.ArgumentParser(description=documentation)
    parser.add_argument("--quick", action="store_true", help="small sizes: shows that it works, and measures nothing")
    parser.add_argument("--results", type=Path, default=RESULTS, help="directory of the JSON lines")
    return parser.parse_args()


@dataclass
class Timing:
    """Repeated runs of one contender."""

    seconds: list[float]
    cores: list[float]  # CPU seconds of this process a second: under a busy machine, or threads sharing a core, too few


def alternate(contenders: dict[str, Callable[[], Any]], repeats: int) -> dict[str, Timing]:
    """Times each contender's runs.

    They run in turn, A B A B …, so that the n-th runs of two of them are neighbours and their ratio holds while the
    machine's speed drifts. Each runs once beforehand, untimed, which compiles and warms it.

    Args:
      contenders: by name; each call must not return before its work is done.
      repeats: timed runs of each.
    """
    for run in contenders.values():
        run()
    timings = {name: Timing([], []) for name in contenders}
    for _ in range(repeats):
        for name, run in contenders.items():
            began, cpu_began = time.perf_counter(), time.process_time()
            run()
            cpu, seconds = time.process_time() - cpu_began, time.perf_counter() - began
            timings[name].seconds.append(seconds)
            timings[name].cores.append(cpu / seconds)
    return timings


def spread(name: str, values: Sequence[float]) -> dict[str, float]:
    """The median of repeated figures under `name`, and their range beside it."""
    figures = {name: statistics.median(values), f"{name}_min": min(values), f"{name}_max": max(values)}
    return {key: float(f"{value:.5g}") for key, value in figures.items()}


def ratios(numerators: Sequence[float], denominators: Sequence[float]) -> list[float]:
    """Of neighbouring runs."""
    return [one / other for one, other in zip(numerators, denominators, strict=True)]


def write_row(options: argparse.Namespace, benchmark: str, row: dict[str, Any]) -> None:
    """Prints one row and appends it to the benchmark's file."""
    row = {"benchmark": benchmark, "quick": options.quick, **row, **records.provenance()}
    print(json.dumps(row), flush=True)
    options.results.mkdir(parents=True, exist_ok=True)
    records.append_rows(options.results / f"{benchmark}.jsonl", [row])
