"""Command lines parsed by tyro into frozen dataclasses, with each of its error boxes turned into one line."""

from __future__ import annotations

import contextlib
import dataclasses
import inspect
import io
import math
import os
import re
import threading
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from typing import Any, TypeVar

import tyro

from ear_jax.cli.flags import Flag, flags_of, near_flags
from ear_jax.errors import UsageError

Parsed = TypeVar("Parsed")
HELP = ("-h", "--help")
MAX_BETA = 1000  # further out a blend hardly turns any more
_parsing = threading.Lock()  # tyro writes to the stderr of the process


def parse(
    kind: type[Parsed], words: list[str], command: str, default: Parsed | None = None, program: str = "ear"
) -> Parsed:
    """Parses a command line into a `kind`; a path that begins with `~` begins with the user's home.

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
    flags = flags_of(kind)
    more = f"(`{program} {command} --help` lists the options)"
    _check_flags(words, flags, more)
    config = (tyro.conf.FlagCreatePairsOff,)
    arguments: dict[str, Any] = {} if default is None else {"default": default}
    try:
        with _parsing, contextlib.redirect_stderr(complaint):
            parsed = tyro.cli(
                kind,
                args=words,
                prog=f"{program} {command}",
                description=inspect.getdoc(kind),
                config=config,
                **arguments,
            )
    except SystemExit as stop:
        if not stop.code:  # --help
            raise
        raise UsageError(f"{_reason(complaint.getvalue(), words, flags)} {more}") from None
    return _at_home(parsed)


def option(metavar: str, default: str = "none") -> Any:
    """Describes an option for `--help`: the name of its value, and its default in words."""
    return tyro.conf.arg(metavar=metavar, help_behavior_hint=f"(default: {default})")


def required(metavar: str) -> Any:
    """Describes for `--help` values of which at least one is needed."""
    return tyro.conf.arg(metavar=metavar, help_behavior_hint="(required)")


def check_finite(flag: str, *values: float) -> None:
    """Raises UsageError unless all numbers given to a flag are finite."""
    if not all(map(math.isfinite, values)):
        raise UsageError(f"{flag} {' '.join(f'{value:g}' for value in values)} is out of range; it must be finite")


def check_least(command: Any, **least: int) -> None:
    """Raises UsageError for the first of the named settings below its minimum."""
    for name, limit in least.items():
        if (value := getattr(command, name)) < limit:
            raise UsageError(f"--{name.replace('_', '-')} {value} is too small; it must be at least {limit}")


def check_most(command: Any, **most: int) -> None:
    """Raises UsageError for the first of the named settings above its maximum."""
    for name, limit in most.items():
        if (value := getattr(command, name)) > limit:
            raise UsageError(f"--{name.replace('_', '-')} {value} is too large; it must be at most {limit}")


def check_betas(betas: Sequence[float]) -> None:
    """Raises UsageError for a β that is not finite or so large that a blend has no direction."""
    check_finite("--beta", *betas)
    if far := [beta for beta in betas if abs(beta) > MAX_BETA]:
        raise UsageError(f"--beta {far[0]:g} is out of range; it must be from {-MAX_BETA} to {MAX_BETA}")


def _check_flags(words: list[str], flags: dict[str, Flag], more: str) -> None:
    """Raises UsageError for the first word that looks like a flag and is none."""
    for word in words:
        name = word.partition("=")[0].replace("_", "-")
        if not word.startswith("--") or name in flags or name in HELP:
            continue
        raise UsageError(f"unknown option {word.partition('=')[0]}{_meant(name, flags)} {more}")
    for name, flag in flags.items():
        is_given = name in [word.replace("_", "-") for word in words]
        if is_given and isinstance(flag.default, tuple) and not _values(words, name):
            raise UsageError(f"{name} needs at least one value {more}")


def _meant(word: str, flags: dict[str, Flag]) -> str:
    """Returns the question that suggests the flags near a word."""
    near = " or ".join(near_flags(word, flags))
    return f"; did you mean {near}?" if near else ""


def _reason(box: str, words: list[str], flags: dict[str, Flag]) -> str:
    """Returns the mistake that tyro's error box reports, in words."""
    # A terminal that cannot show the frame gets other characters, or blanks.
    lines = [line.strip("│|╭╮╰╯─ ") for line in box.splitlines()]
    paragraphs = [list(group) for text, group in groupby(lines[1:], lambda line: line.strip("-") != "") if text]
    message = " ".join(paragraphs[0]) if paragraphs else "the command line cannot be read"
    if stray := re.match(r"Unrecognized options: ([^\s,]+)", message):
        if stray[1].startswith("-"):
            return f"unknown option {stray[1]}{_meant(stray[1], flags)}"
        return f"{stray[1]!r} is one word too many"
    if missing := re.match(r"Missing from .*?: (\S+(?: [A-Z])*) ([A-Z][a-z].*?)\.? \(required\)", message):
        return f"{missing[1]} is missing: {missing[2][0].lower()}{missing[2][1:]}"
    named = [flags[name] for name in re.findall(r"--[\w.-]*\w", message) if name in flags]
    if named:
        given = " ".join(_values(words, named[0].name))
        return (
            f"{named[0].name} takes {named[0].takes}, not {given!r}"
            if given
            else f"{named[0].name} needs {named[0].takes}"
        )
    return message


def _values(words: list[str], flag: str) -> list[str]:
    """Returns the words given to a flag when it was given last."""
    values: list[str] = []
    taking = False
    for word in words:
        name, equals, value = word.partition("=")
        if word.startswith("--"):
            taking = name.replace("_", "-") == flag
            values = ([value] if equals else []) if taking else values
        elif taking:
            values.append(word)
    return values


def _at_home(parsed: Parsed) -> Parsed:
    """Returns a command with `~` replaced in its paths, as a shell does not do it in `--out=~/run`."""
    paths = {
        field.name: Path(os.path.expanduser(value))
        for field in dataclasses.fields(parsed)  # type: ignore[arg-type]
        if isinstance(value := getattr(parsed, field.name), Path) and str(value).startswith("~")
    }
    return dataclasses.replace(parsed, **paths) if paths else parsed  # type: ignore[type-var]


def shield(words: list[str]) -> list[str]:
    """Puts a blank before words such as -abs(velocity), which would be read as options; no command has such options."""
    return [f" {word}" if word.startswith("-") and word[1:2] != "-" and word != "-h" else word for word in words]
