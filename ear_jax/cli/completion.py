"""`ear completion SHELL`."""

from __future__ import annotations

import contextlib
import importlib
import io
from dataclasses import dataclass
from typing import Any, Literal

import tyro

from ear_jax.cli.arguments import parse


@dataclass(frozen=True)
class CompletionCommand:
    """Print a script that completes commands and flags: for bash, eval "$(ear completion bash)".

    Example: ear completion bash
    """

    shell: tyro.conf.Positional[Literal["bash", "zsh"]]
    """The shell. For zsh, save the script as _ear in a directory of its $fpath."""


def main(words: list[str]) -> None:
    command = parse(CompletionCommand, words, "completion")
    print(script(command.shell))


def script(shell: str) -> str:
    """Returns the script for a shell, which tyro writes."""
    printed = io.StringIO()
    arguments = ["--tyro-print-completion", shell]
    with contextlib.redirect_stdout(printed), contextlib.suppress(SystemExit):
        tyro.extras.subcommand_cli_from_dict(
            commands(), prog="ear", args=arguments, config=(tyro.conf.FlagCreatePairsOff,)
        )
    return printed.getvalue()


def commands() -> dict[str, Any]:
    """Returns the dataclass of every subcommand by name."""
    from ear_jax.cli.main import COMMANDS

    found: dict[str, Any] = {}
    for name, (module, _) in COMMANDS.items():
        members = vars(importlib.import_module(module))
        own = [value for key, value in members.items() if key.endswith("Command") and value.__module__ == module]
        found |= {name: own[0]} if own else {}
    return found
