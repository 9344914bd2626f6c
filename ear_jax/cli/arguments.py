"""Command lines parsed by tyro into frozen dataclasses, with each of its error boxes turned into one line."""

from __future__ import annotations

import contextlib
import io
import math
from itertools import groupby
from typing import Any, TypeVar

import tyro

from ear_jax.errors import UsageError

Parsed = TypeVar("Parsed")


def parse(
    kind: type[Parsed], words: list[str], command: str, default: Parsed | None = None, program: str = "ear"
) -> Parsed:
    """Parses a command line into a `kind`.

    Args:
      kind: a dataclass; nested ones become `--group.setting`.
      words: the words after the subcommand.
      command: the subcommand, for messages and `--help`.
      default: the settings that the command line does not give.
      program: the program that the subcommand belongs to.

    Raises:
      UsageError: one line with the mistake and the nearest real setting.
    """
    complaint = io.StringIO()
    words = [word.capitalize() if word in ("true", "false") else word for word in words]
    config = (tyro.conf.FlagCreatePairsOff,)
    arguments: dict[str, Any] = {} if default is None else {"default": default}
    try:
        with contextlib.redirect_stderr(complaint):
            return tyro.cli(kind, args=words, prog=f"{program} {command}", config=config, **arguments)
    except SystemExit as stop:
        if not stop.code:  # --help
            raise
        raise UsageError(_one_line(complaint.getvalue(), f"{program} {command}")) from None


def option(metavar: str, default: str = "none") -> Any:
    """Describes an option for `--help`: the name of its value, and its default in words."""
    return tyro.conf.arg(metavar=metavar, help_behavior_hint=f"(default: {default})")


def check_finite(flag: str, *values: float) -> None:
    """Raises UsageError unless all numbers given to a flag are finite."""
    if not all(map(math.isfinite, values)):
        raise UsageError(f"{flag} {' '.join(f'{value:g}' for value in values)} is out of range; it must be finite")


def check_least(command: Any, **least: int) -> None:
    """Raises UsageError for the first of the named settings below its minimum."""
    for name, limit in least.items():
        if (value := getattr(command, name)) < limit:
            raise UsageError(f"--{name} {value} is too small; it must be at least {limit}")


def _one_line(box: str, command: str) -> str:
    """Extracts the first paragraph below the title of tyro's error box, and the first setting that it suggests."""
    # A terminal that cannot show the frame gets other characters, or blanks.
    lines = [line.strip("│|╭╮╰╯─ ") for line in box.splitlines()]
    paragraphs = [list(group) for text, group in groupby(lines[1:], lambda line: line.strip("-") != "") if text]
    message = " ".join(paragraphs[0])
    if "Perhaps you meant:" in lines:
        near = lines[lines.index("Perhaps you meant:") + 1].split()[0].split(",")[0]
        message += f"; did you mean {near}?"
    return f"{message} (`{command} --help` lists the options)"
