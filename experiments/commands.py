"""The `ear` command lines behind a result. Imports no JAX."""

from __future__ import annotations

import os
import shlex
from pathlib import Path

from ear_jax.config import Config, flat
from ear_jax.presets import preset_config
from experiments.inventory import POLICY, Job
from experiments.paper import Analysis

RUNS = Path("runs")


def train_words(job: Job) -> list[str]:
    """The `ear` command that trains a job, or continues it, or finds it finished."""
    config = job.config
    words = ["train", config.family, "--agent", config.agent, "--preset", config.preset, "--seed", str(config.seed)]
    words += ["--seeds", str(config.seeds)] if config.seeds > 1 else []
    return words if config.minutes is None else [*words, "--minutes", f"{config.minutes:g}"]


def is_copied(run: Path, record: Path) -> bool:
    """Whether a run on this machine is the one that a record is of."""
    rows, kept = (place / "metrics.jsonl" for place in (run, record))
    return rows.is_file() and kept.is_file() and rows.read_bytes() == kept.read_bytes()


def export_words(run: Path, record: Path) -> list[str]:
    """The `ear` command that puts a run's policy into its record."""
    return ["export", str(run), _from_here(record / POLICY)]


def analysis_words(job: Job, analysis: Analysis) -> list[str]:
    """The `ear` command that makes an analysis of a job's run or, where that is not the recorded one, of the policy."""
    run = RUNS / job.name
    holder = _from_here(job.policy) if job.policy.is_file() and not is_copied(run, job.record) else str(run)
    return [analysis.command, holder, *analysis.options, "--json"]


def _from_here(path: Path) -> str:
    """As a command in this directory names it: records keep commands, and no record is of one machine."""
    return os.path.relpath(path)


def command_line(config: Config) -> str:
    """`ear train` with these settings: what today's preset has otherwise is a flag, but for engine and checkpoints."""
    words = ["ear", "train", config.family]
    usual = {**flat(preset_config(config.family, config.preset, config.agent)), "preset": "fast", "agent": "ear"}
    for name, value in flat(config).items():
        if value != usual[name] and name.split(".")[0] not in ("engine", "checkpoint"):
            values = value if isinstance(value, tuple) else [value]
            words.append(f"--{name.replace('_', '-')}")
            words += [f"{one:g}" if isinstance(one, float) else str(one) for one in values]
    return shlex.join(words)
