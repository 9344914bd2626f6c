"""Shared code of the benchmarks: interleaved timing, and rows with their machine and commit. Imports no JAX."""

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
    """Parses the command line of a benchmark."""
    parser = argparse.ArgumentParser(description=documentation)
    parser.add_argument(
        "--quick", action="store_true", help="small sizes: checks that the benchmark works; the timings mean nothing"
    )
    parser.add_argument("--results", type=Path, default=RESULTS, help="directory of the JSON lines files")
    return parser.parse_args()


@dataclass
class Timing:
    """Repeated runs of one contender."""

    seconds: list[float]
    cores: list[float]  # CPU seconds of this process per second; low on a busy machine or if threads share a core


def alternate(contenders: dict[str, Callable[[], Any]], repeats: int) -> dict[str, Timing]:
    """Times each contender's runs.

    Runs are interleaved, A B A B …, so that the ratio of the n-th runs of two contenders is robust to drift of the
    machine's speed. Each contender first runs once untimed, to compile and warm up.

    Args:
      contenders: calls by name; a call must not return before its work is done.
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
    """Returns the median of repeated measurements under `name`, with their minimum and maximum."""
    figures = {name: statistics.median(values), f"{name}_min": min(values), f"{name}_max": max(values)}
    return {key: float(f"{value:.5g}") for key, value in figures.items()}


def ratios(numerators: Sequence[float], denominators: Sequence[float]) -> list[float]:
    """Returns the ratios of paired runs."""
    return [above / below for above, below in zip(numerators, denominators, strict=True)]


def write_row(options: argparse.Namespace, benchmark: str, row: dict[str, Any]) -> None:
    """Prints a row and appends it to the benchmark's file."""
    row = {"benchmark": benchmark, "quick": options.quick, **row, **records.provenance()}
    print(json.dumps(row), flush=True)
    options.results.mkdir(parents=True, exist_ok=True)
    records.append_rows(options.results / f"{benchmark}.jsonl", [row])
