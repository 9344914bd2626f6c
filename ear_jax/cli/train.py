"""`ear train FAMILY`."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Annotated

import tyro

from ear_jax.cli.arguments import parse
from ear_jax.config import Config, preset_config
from ear_jax.envs.registry import FAMILIES, find_family
from ear_jax.errors import UsageError
from ear_jax.run import default_directory, train_run
from ear_jax.runtime import enable_cache


@dataclass(frozen=True)
class TrainCommand:
    """Train a policy on a family of tasks. The same command on an unfinished run continues it."""

    config: Annotated[tyro.conf.FlagConversionOff[Config], tyro.conf.arg(name="")]
    out: Path | None = None
    """The run directory; by default runs/FAMILY-AGENT-PRESET-seedN."""


def main(words: list[str]) -> None:
    enable_cache()
    command = read(words)
    train_run(command.config, command.out or default_directory(command.config))


def read(words: list[str]) -> TrainCommand:
    """The command line over the preset it names."""
    family, rest = _family(words)
    base = preset_config(family, _option(rest, "--preset", "fast"), _option(rest, "--agent", "ear"))
    return parse(TrainCommand, [family, *rest], "train", TrainCommand(base))


def _option(words: list[str], name: str, default: str) -> str:
    """What an option is set to, ahead of the parsing of all."""
    value = default
    for word, following in zip_longest(words, words[1:]):
        if word == name and following is not None:
            value = following
        elif word.startswith(name + "="):
            value = word.partition("=")[2]
    return value


def _family(words: list[str]) -> tuple[str, list[str]]:
    """The family, which comes first, and the rest."""
    if words and words[0] in ("-h", "--help"):
        return next(iter(FAMILIES)), words
    if not words or words[0].startswith("-"):
        raise UsageError(f"name a family first: ear train FAMILY (there are: {', '.join(sorted(FAMILIES))})")
    find_family(words[0])
    return words[0], words[1:]
