"""`ear export RUN FILE`."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import tyro

from ear_jax import records
from ear_jax.cli.arguments import parse
from ear_jax.errors import UsageError
from ear_jax.export import SUFFIX, write_policy
from ear_jax.trained import Trained, load, pick


@dataclass(frozen=True)
class ExportCommand:
    """Write a run's newest policy to one file, which every command takes that takes a run. It has no replay."""

    run: tyro.conf.Positional[Path]
    """The run directory, an exported file, or pretrained:NAME."""
    file: tyro.conf.Positional[Path]
    """The file, FILE.safetensors, which must not be there yet."""
    policy: int | None = None
    """Of a run of several seeds, whose policy: 0 is the first. By default those of all."""
    family: str | None = None
    """A family of your own has to be named again, as for `ear train`."""
    json: bool = False
    """Print one JSON document and nothing else."""


def main(words: list[str]) -> None:
    command = parse(ExportCommand, words, "export")
    if command.file.suffix != SUFFIX:
        raise UsageError(f"{command.file} must end in {SUFFIX}")
    if command.file.exists():
        raise UsageError(f"{command.file} is there already; name another file")
    trained = load(command.run, command.family, "auto")  # no physics is stepped: not that of its own machine
    if command.policy is not None:
        trained = pick(trained, command.policy)
    card = write(command.file, trained, records.read_rows(command.run / "metrics.jsonl"))
    size = command.file.stat().st_size
    if command.json:
        print(json.dumps({"file": str(command.file), "bytes": size, "epoch": trained.epoch, "card": card}))
    else:
        print(f"{card}\n\n{command.file}: {size:,} bytes")


def write(file: Path, trained: Trained, rows: list[dict[str, Any]]) -> str:
    """Writes policies to a file, and returns its card; arguments and errors as `describe` and `write_policy`."""
    about = {name: value for name, value in trained.about.items() if name != "leaves"}
    card = describe(trained, rows)
    codes = jax.vmap(trained.program.agent.codes)(trained.policies)
    write_policy(file, trained.policies, codes, about, card)
    return card


def describe(trained: Trained, rows: list[dict[str, Any]]) -> str:
    """The card: what a person should know who is handed the file.

    Args:
      trained: the policies.
      rows: the run's metrics; of them the evaluation of these policies at their epoch is told.
    """
    program, about = trained.program, trained.about
    config, versions = program.config, about["versions"]
    seeds = range(config.seed, config.seed + config.seeds)
    found = [row["mean_return"] for row in rows if row["epoch"] == trained.epoch and row["seed"] in seeds]
    beside = f", one of {about['side_by_side']} trained side by side" if "side_by_side" in about else ""
    reached = f", mean return {sum(found) / len(found):.1f}" if found else ""
    return "\n".join(
        [
            f"{config.family}, agent {config.agent}, preset {config.preset}, seeds from {config.seed}: {config.seeds}"
            f"{beside}",
            f"tasks, in the order of the code table: {', '.join(program.tasks.names)}",
            f"trained for {trained.epoch} epochs, {program.env_steps(trained.collected):,} env steps and "
            f"{trained.epoch * config.sac.updates:,} updates a seed{reached}",
            f"engine {about['engine']}, mujoco {versions['mujoco']}, jax {versions['jax']}, commit {about['commit']}",
            "policy.* are the networks' parameters [seeds, …], codes the table [seeds, tasks, code]",
        ]
    )
