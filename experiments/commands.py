"""The `ear` command lines behind a result. Imports no JAX."""

from __future__ import annotations

from pathlib import Path

from experiments.inventory import Job
from experiments.paper import Analysis

RUNS = Path("runs")


def train_words(job: Job) -> list[str]:
    """The `ear` command that trains a job, or continues it, or finds it finished."""
    config = job.config
    words = ["train", config.family, "--agent", config.agent, "--preset", config.preset, "--seed", str(config.seed)]
    return words if config.minutes is None else [*words, "--minutes", f"{config.minutes:g}"]


def analysis_words(job: Job, analysis: Analysis) -> list[str]:
    """The `ear` command that makes an analysis of a job's run."""
    return [analysis.command, str(RUNS / job.name), *analysis.options, "--json"]
