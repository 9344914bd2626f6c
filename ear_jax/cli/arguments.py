"""Command lines parsed by tyro into frozen dataclasses, with its boxed complaints turned into one line."""

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
    """The command line as a `kind`.

    Args:
      kind: a dataclass; nested ones become `--group.setting`.
      words: what follows the subcommand.
      command: the subcommand, for messages and `--help`.
      default: where settings stand that the command line does not name.
      program: whose subcommand it is.

    Raises:
      UsageError: what is wrong, in one line, with the nearest real setting.
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


def check_finite(flag: str, *values: float) -> None:
    """Raises UsageError unless all numbers given to a flag are finite."""
    if not all(map(math.isfinite, values)):
        raise UsageError(f"{flag} {' '.join(f'{value:g}' for value in values)} is out of range; it must be finite")


def check_least(command: Any, **least: int) -> None:
    """Raises UsageError unless the settings named are at least so large."""
    for name, limit in least.items():
        if (value := getattr(command, name)) < limit:
            raise UsageError(f"--{name} {value} is too small; it must be at least {limit}")


def _one_line(box: str, command: str) -> str:
    """What tyro says first in its box, below the title, and the first setting it proposes."""
    # The frame is of other characters, or blank, where the terminal cannot show it.
    lines = [line.strip("│|╭╮╰╯─ ") for line in box.splitlines()]
    paragraphs = [list(group) for text, group in groupby(lines[1:], lambda line: line.strip("-") != "") if text]
    message = " ".join(paragraphs[0])
    if "Perhaps you meant:" in lines:
        near = lines[lines.index("Perhaps you meant:") + 1].split()[0].split(",")[0]
        message += f"; did you mean {near}?"
    return f"{message} (`{command} --help` tells the options)"
