"""The flags of a command line, read from its dataclass: their names, and in words what each of them takes."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import tyro

from ear_jax.errors import nearest

WORDS: dict[Any, tuple[str, str]] = {  # of one value, and of any number of them
    int: ("a whole number", "whole numbers"),
    float: ("a number", "numbers"),
    bool: ("true or false", "true or false"),
}


@dataclasses.dataclass(frozen=True)
class Flag:
    """One setting of a command line."""

    name: str  # with its dashes
    takes: str  # in words, as in `a number`
    default: Any
    is_switch: bool = False  # takes no value


def flags_of(kind: type, where: str = "--", with_switches: bool = True) -> dict[str, Flag]:
    """Returns the flags of a command's dataclass by name; nested dataclasses have `--group.setting`.

    Args:
      kind: the dataclass.
      where: the start of the names.
      with_switches: a bool is a switch, `--json` or `--no-film`; otherwise it takes a value.
    """
    found: dict[str, Flag] = {}
    hints = get_type_hints(kind, include_extras=True)
    for field in dataclasses.fields(kind):
        plain, notes = without_notes(hints[field.name])
        own = next((note.name for note in notes if getattr(note, "name", None)), field.name)
        name = where + own.replace("_", "-")
        if tyro.conf.Positional in notes:
            continue
        if dataclasses.is_dataclass(plain):
            named = not any(getattr(note, "name", None) == "" for note in notes)
            inner = with_switches and tyro.conf.FlagConversionOff not in notes
            found |= flags_of(plain, f"{name}." if named else where, inner)  # type: ignore[arg-type]
        elif plain is bool and with_switches:
            name = f"--no-{name.removeprefix('--')}" if field.default is True else name
            found[name] = Flag(name, "no value", field.default, is_switch=True)
        else:
            metavar = next((note.metavar for note in notes if getattr(note, "metavar", None)), None)
            found[name] = Flag(name, _takes(plain, metavar), field.default)
    return found


def near_flags(word: str, flags: Iterable[str]) -> list[str]:
    """Returns the flags, at most three, that a mistyped one may mean: `--lr` is near `--sac.lr`, `--epo` `--epochs`.

    Settings outside of groups come first, then those whose own name, after the group, is alike.
    """
    stem = word.lstrip("-").replace("_", "-").lower()
    own = [(name.lstrip("-"), name.rpartition(".")[2].lstrip("-"), name) for name in flags]
    rules = (
        lambda whole, _: whole in (stem, f"no-{stem}"),
        lambda _, last: last == stem,
        lambda whole, _: len(stem) > 1 and whole.startswith(stem),
        lambda _, last: len(stem) > 1 and last.startswith(stem),
    )
    for rule in rules:
        if found := [name for whole, last, name in own if rule(whole, last)]:
            return found[:3]
    for names in ({whole: name for whole, _, name in own}, {last: name for _, last, name in own}):
        if found := nearest(stem, names):
            return [names[found[0]]]
    return []


def without_notes(hint: Any) -> tuple[Any, tuple[Any, ...]]:
    """Splits `Annotated[X | None, …]` into X and its notes."""
    notes: tuple[Any, ...] = ()
    while get_origin(hint) is Annotated:
        hint, *more = get_args(hint)
        notes += tuple(more)
    if get_origin(hint) in (Union, UnionType):
        first, *others = (one for one in get_args(hint) if one is not NoneType)
        if not others:
            inner, deeper = without_notes(first)
            return inner, (*notes, *deeper)
    return hint, notes


def _takes(plain: Any, metavar: str | None) -> str:
    """Describes in words the value or values of a flag."""
    if get_origin(plain) is Literal:
        *first, last = map(str, get_args(plain))
        return f"{', '.join(first)} or {last}"
    if get_origin(plain) is tuple:
        kinds = get_args(plain)
        if kinds[-1] is not Ellipsis:
            return f"{len(kinds)} values, {metavar or ' '.join('X' * len(kinds))}"
        return WORDS.get(kinds[0], ("", metavar or "values"))[1]
    return WORDS.get(plain, (metavar or {Path: "a path"}.get(plain, "a value"), ""))[0]
