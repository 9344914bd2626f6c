"""`ear train FAMILY`."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Annotated

import tyro

from ear_jax.cli.arguments import option, parse
from ear_jax.config import Config, flat
from ear_jax.envs.registry import FAMILIES, find_family
from ear_jax.errors import UsageError
from ear_jax.presets import check_effect, preset_config
from ear_jax.process.runtime import enable_cache
from ear_jax.runs.directory import check_place, default_directory
from ear_jax.runs.documents import header
from ear_jax.runs.estimate import check_memory, gigabytes, memory, times
from ear_jax.runs.loop import train_run
from ear_jax.runs.training import make_program


@dataclass(frozen=True)
class TrainCommand:
    """Train a policy on a family of tasks: ear train FAMILY. The same command continues an unfinished run."""

    config: Annotated[tyro.conf.FlagConversionOff[Config], tyro.conf.arg(name="")]
    out: Annotated[Path | None, option("DIRECTORY", "runs/FAMILY-AGENT-PRESET-seedN")] = None
    """The run directory."""
    dry_run: bool = False
    """Print the settings, the memory they need and their speed on this machine, without training or writing."""


def main(words: list[str]) -> None:
    enable_cache()
    command = read(words)
    check_effect(command.config)
    directory = command.out or default_directory(command.config)
    if command.dry_run:
        print_estimate(command.config, directory)
    else:
        train_run(command.config, directory)


def print_estimate(config: Config, directory: Path) -> None:
    """Prints the estimate of `--dry-run`; raises the errors that `ear train` would raise."""
    check_place(directory)
    program = make_program(config)
    check_memory(program)
    print(header(program, directory))
    for name, value in flat(config).items():
        print(f"  {name.replace('_', '-')} {value}")
    needed = memory(program)
    free = "" if needed.available is None else f"; {gigabytes(needed.available)} are free"
    parts = f"replay {gigabytes(needed.replay)}, networks and optimisers {gigabytes(needed.learner)}"
    print(f"memory: {gigabytes(needed.total)} ({parts}){free}")
    taken = times(config)
    blocks = math.ceil(config.epochs / config.log.epochs)
    minutes = (config.epochs * taken.epoch + blocks * taken.evaluation) / 60
    print(
        f"time here: {taken.compiling:.0f} s to compile, {taken.epoch:.2f} s per epoch, {taken.evaluation:.2f} s per "
        f"evaluation every {config.log.epochs} epochs; {config.epochs} epochs take {minutes:.0f} minutes"
    )


def read(words: list[str]) -> TrainCommand:
    """Parses the command line, over the settings of the preset and the agent that it names."""
    family, rest = _family(words)
    base = preset_config(family, _option(rest, "--preset", "fast"), _option(rest, "--agent", "ear"))
    return parse(TrainCommand, [family, *rest], "train", TrainCommand(base))


def _option(words: list[str], name: str, default: str) -> str:
    """Returns the last value given to an option, before the whole command line is parsed."""
    value = default
    for word, following in zip_longest(words, words[1:]):
        if word == name and following is not None:
            value = following
        elif word.startswith(name + "="):
            value = word.partition("=")[2]
    return value


def _family(words: list[str]) -> tuple[str, list[str]]:
    """Splits the words into the family, which comes first, and the rest."""
    if words and words[0] in ("-h", "--help"):
        return next(iter(FAMILIES)), words
    if not words or words[0].startswith("-"):
        raise UsageError(f"name a family first: ear train FAMILY (there are: {', '.join(sorted(FAMILIES))})")
    find_family(words[0])
    return words[0], words[1:]
