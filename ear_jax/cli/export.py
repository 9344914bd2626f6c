"""`ear export RUN FILE`."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import tyro

from ear_jax.cli.arguments import parse
from ear_jax.errors import UsageError
from ear_jax.runs import records
from ear_jax.runs.export import SUFFIX
from ear_jax.runs.trained import load, pick, save


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
    card = save(command.file, trained, records.read_rows(command.run / "metrics.jsonl"))
    size = command.file.stat().st_size
    if command.json:
        print(json.dumps({"file": str(command.file), "bytes": size, "epoch": trained.epoch, "card": card}))
    else:
        print(f"{card}\n\n{command.file}: {size:,} bytes")
