"""`ear export RUN FILE`."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from ear_jax.cli.arguments import option, parse
from ear_jax.cli.on_run import load_run
from ear_jax.errors import UsageError
from ear_jax.pretrained import SUFFIX
from ear_jax.runs import records


@dataclass(frozen=True)
class ExportCommand:
    """Write a run's newest policy to one file, which every command accepts in place of a run. It holds no replay.

    Example: ear export pretrained:hopper-vel hopper.safetensors
    """

    run: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="RUN")]]
    """The run directory, an exported file, or pretrained:NAME."""
    file: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="FILE")]]
    """The new file, which must end in .safetensors."""
    policy: Annotated[int | None, option("INT", "those of all seeds")] = None
    """The policy to write of a run with several seeds; 0 is the first seed's."""
    family: Annotated[str | None, option("FAMILY", "the run's")] = None
    """The run's family, as for `ear train`; required for a family of your own."""
    json: bool = False
    """Print one JSON document and nothing else."""


def main(words: list[str]) -> None:
    command = parse(ExportCommand, words, "export")
    if command.file.suffix != SUFFIX:
        raise UsageError(f"{command.file} must end in {SUFFIX}")
    if command.file.exists():
        raise UsageError(f"{command.file} already exists; name another file")
    trained = load_run(command.run, command.family, "auto")  # no physics is stepped, so that any engine will do
    from ear_jax.runs.trained import pick, save

    if command.policy is not None:
        trained = pick(trained, command.policy)
    card = save(command.file, trained, records.read_rows(command.run / "metrics.jsonl"))
    size = command.file.stat().st_size
    if command.json:
        print(json.dumps({"file": str(command.file), "bytes": size, "epoch": trained.epoch, "card": card}))
    else:
        print(f"{card}\n\n{command.file}: {size:,} bytes")
