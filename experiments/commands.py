"""The `ear` command lines behind a result. Imports no JAX."""

from __future__ import annotations

import os
from pathlib import Path

from experiments.inventory import POLICY, Job
from experiments.paper import Analysis

RUNS = Path("runs")
IN_HAND = ".reproduce"  # in it: the directory of locks, so that several processes can share a table


def train_words(job: Job) -> list[str]:
    """Returns the `ear` command that trains a job; on a started run it continues, on a finished run it does nothing."""
    config = job.config
    words = ["train", config.family, "--agent", config.agent, "--preset", config.preset, "--seed", str(config.seed)]
    words += ["--seeds", str(config.seeds)] if config.seeds > 1 else []
    return words if config.minutes is None else [*words, "--minutes", f"{config.minutes:g}"]


def is_copied(run: Path, record: Path) -> bool:
    """Returns whether a run on this machine is the source of a record."""
    rows, recorded = (directory / "metrics.jsonl" for directory in (run, record))
    return rows.is_file() and recorded.is_file() and rows.read_bytes() == recorded.read_bytes()


def export_words(run: Path, record: Path) -> list[str]:
    """Returns the `ear` command that exports a run's policy to its record."""
    return ["export", str(run), _from_here(record / POLICY)]


def analysis_words(job: Job, analysis: Analysis) -> list[str]:
    """Returns the `ear` command of an analysis: on the job's run, or on the recorded policy if the run is not here."""
    run = RUNS / job.name
    holder = _from_here(job.policy) if job.policy.is_file() and not is_copied(run, job.record) else str(run)
    holder = _from_here(job.record / analysis.of) if analysis.of else holder
    written = [_from_here(job.record / analysis.writes)] if analysis.writes else []
    return [analysis.command, holder, *written, *analysis.options, "--json"]


def _from_here(path: Path) -> str:
    """Returns a path relative to the working directory: commands are recorded, and must not depend on a machine."""
    return os.path.relpath(path)
