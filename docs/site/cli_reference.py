"""The reference of the command line, written from the dataclasses that parse it."""

from __future__ import annotations

import ast
import dataclasses
import inspect
import textwrap
from collections.abc import Iterator
from typing import Any, get_type_hints

import tyro

from ear_jax.cli.completion import commands
from ear_jax.cli.config import USAGE
from ear_jax.cli.flags import without_notes
from ear_jax.cli.main import COMMANDS


def page() -> str:
    """Returns the page as Markdown."""
    parts = [
        "# Command line",
        "`ear COMMAND --help` prints the same in a terminal. A mistake gives one line and exit code 2; a request that "
        "cannot be carried out here gives one line and exit code 1.",
        "The defaults of `ear train` are those of the preset `paper` for HalfCheetah-Vel; `ear config FAMILY` prints "
        "the settings of a preset.",
    ]
    kinds = commands()
    for name in COMMANDS:
        parts += [f"## ear {name}", section(kinds[name]) if name in kinds else f"```\n{USAGE}\n```"]
    return "\n\n".join(parts) + "\n"


def section(kind: type) -> str:
    """Returns the options of one command, as Markdown."""
    about, _, example = (inspect.getdoc(kind) or "").partition("\n\nExample: ")
    about = f"{' '.join(about.split())}\n\n```\n{example}\n```" if example else " ".join(about.split())
    rows = [
        f"**`{flag}`**{f' (default: `{default}`)' if default else ''}  \n{text}\n"
        for flag, default, text in options(kind)
    ]
    return "\n".join([about, "", *rows])


def options(kind: type, where: str = "--") -> Iterator[tuple[str, str, str]]:
    """Yields flag, default and description of each option of a command's dataclass."""
    hints, texts = get_type_hints(kind, include_extras=True), descriptions(kind)
    for field in dataclasses.fields(kind):
        plain, notes = without_notes(hints[field.name])
        own = next((note.name for note in notes if getattr(note, "name", None)), field.name).replace("_", "-")
        if dataclasses.is_dataclass(plain):
            unnamed = any(getattr(note, "name", None) == "" for note in notes)
            yield from options(plain, where if unnamed else f"{where}{own}.")  # type: ignore[arg-type]
            continue
        metavar = next((note.metavar for note in notes if getattr(note, "metavar", None)), None)
        name = (metavar or own.upper()) if tyro.conf.Positional in notes else where + own
        yield name, default_of(field, notes), texts.get(field.name, "")


def default_of(field: dataclasses.Field[Any], notes: tuple[Any, ...]) -> str:
    """Returns an option's default in words; empty if it has none, or if a preset gives it."""
    hint = next((note.help_behavior_hint for note in notes if getattr(note, "help_behavior_hint", None)), "")
    if isinstance(hint, str) and hint.startswith("(default: "):
        return hint.removeprefix("(default: ").removesuffix(")")
    if field.default in (dataclasses.MISSING, None, ()):
        return ""
    return str(field.default).lower() if isinstance(field.default, bool) else str(field.default)


def descriptions(kind: type) -> dict[str, str]:
    """Returns the text below each field of a dataclass and of those it derives from."""
    found: dict[str, str] = {}
    for base in reversed(kind.__mro__[:-1]):
        (body,) = ast.parse(textwrap.dedent(inspect.getsource(base))).body
        assert isinstance(body, ast.ClassDef)
        for field, text in zip(body.body, body.body[1:], strict=False):
            if isinstance(field, ast.AnnAssign) and isinstance(text, ast.Expr) and isinstance(text.value, ast.Constant):
                found[ast.unparse(field.target)] = " ".join(str(text.value.value).split())
    return found
