"""`ear log RUN`."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import tyro

from ear_jax.cli.arguments import parse
from ear_jax.config import from_dict
from ear_jax.errors import RunError, UsageError, counted
from ear_jax.process.terminal import say
from ear_jax.runs import records
from ear_jax.runs.lock import InUse, lock_directory
from ear_jax.runs.tracking import TENSORBOARD, tracking


@dataclass(frozen=True)
class LogCommand:
    """Copy the metrics of a run that exists to TensorBoard or Weights & Biases.

    Example: ear log runs/halfcheetah-vel-ear-fast-seed0 --tensorboard
    """

    run: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="RUN")]]
    """The run directory."""
    tensorboard: bool = False
    """Write event files into the run's directory, in place of those that are there."""
    wandb: bool = False
    """Write to Weights & Biases (pip install 'ear-jax[wandb]'); with WANDB_MODE=offline, into the run's directory."""
    json: bool = False
    """Print one JSON document and nothing else."""


def main(words: list[str]) -> None:
    command = parse(LogCommand, words, "log")
    if not (command.tensorboard or command.wandb):
        raise UsageError("say where to: --tensorboard, --wandb or both")
    config = from_dict(records.read_run(command.run)["config"])
    config = replace(config, log=replace(config.log, tensorboard=command.tensorboard, wandb=command.wandb))
    try:
        with lock_directory(command.run, say):  # a training writes event files too
            rows = len(records.read_rows(command.run / "metrics.jsonl"))
            with tracking(command.run, config, say):
                pass
    except InUse:
        raise RunError(f"{command.run} is in use; log it once its training has ended or stopped") from None
    folder = command.run / TENSORBOARD
    if command.json:
        print(json.dumps({"rows": rows, "tensorboard": str(folder) if command.tensorboard else None}))
        return
    print(f"{counted(rows, 'row')} of metrics copied")
    if command.tensorboard:
        print(f"tensorboard --logdir {folder}")
