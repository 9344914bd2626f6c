"""Errors that a command reports in one line, and suggestions for mistyped names."""

from __future__ import annotations

import difflib
import os
import re
import traceback
from collections.abc import Iterable

NUMBER = r"(\d+(?:\.\d+)?)"
NUMBERED = r"(.*?[^\d.])" + NUMBER


class UsageError(Exception):
    """The request is invalid; one line says what is allowed. Exit code 2."""


class RunError(Exception):
    """The request is valid but cannot be carried out here; one line says why. Exit code 1."""


def known_name(kind: str, word: str, known: Iterable[str]) -> str:
    """Returns the known name that a word means, whatever its case; raises UsageError if there is none."""
    known = list(known)
    same = [name for name in known if name == word] or [name for name in known if name.lower() == word.lower()]
    if not same:
        raise unknown(kind, word, known)
    return same[0]


def unknown(kind: str, word: str, known: Iterable[str]) -> UsageError:
    """Returns the error for an unknown name; it suggests the nearest known names and lists all of them."""
    known = in_order(known)
    return UsageError(f"unknown {kind} {word!r}{hint(nearest(word, known))} (there are: {', '.join(known) or 'none'})")


def hint(names: Iterable[str]) -> str:
    """Returns the question that ends a message, as in `; did you mean 'train'?`; empty without names."""
    quoted = " or ".join(map(repr, names))
    return f"; did you mean {quoted}?" if quoted else ""


def nearest(word: str, known: Iterable[str]) -> list[str]:
    """Returns the known names, at most three, that a mistyped word may mean.

    A number is near its neighbours by value: 1.5 lies between vel-1 and vel-2. Other words are near the names that
    begin with them or contain them, or else the one that differs in few letters.
    """
    known, wanted = in_order(known), word.lower()
    if numbered := _neighbours(wanted, known):
        return numbered
    for matches in (str.startswith, str.__contains__):
        found = [name for name in known if len(wanted) > 2 and matches(name.lower(), wanted)]
        if found:
            return found[:3]
    lowered = {name.lower(): name for name in reversed(known)}
    return [lowered[name] for name in difflib.get_close_matches(wanted, lowered, n=1)]


def counted(number: int, noun: str) -> str:
    """Returns a number of things in words, as in 1 blend or 1,000 blends."""
    return f"{number:,} {noun}{'s' * (number != 1)}"


def in_order(names: Iterable[str]) -> list[str]:
    """Sorts names, and numbers in them by value: vel-2 comes before vel-10."""

    def parts(name: str) -> list[tuple[bool, float, str]]:
        pieces = re.split(NUMBER, name.lower())
        return [(bool(i % 2), float(piece) if i % 2 else 0.0, piece) for i, piece in enumerate(pieces)]

    return sorted(names, key=lambda name: (parts(name), name))


def _neighbours(word: str, known: list[str]) -> list[str]:
    """Returns the names that differ from a word only in the number they end with: next below and next above it."""
    match = re.fullmatch(NUMBERED, word)
    if match is None:
        return []
    stem, value = match[1], float(match[2])
    alike = [found for found in (re.fullmatch(NUMBERED, name) for name in known) if found and found[1].lower() == stem]
    values = {found[0]: float(found[2]) for found in alike}
    below = [name for name in values if values[name] <= value]
    above = [name for name in values if values[name] > value]
    return [*sorted(below, key=values.__getitem__)[-1:], *sorted(above, key=values.__getitem__)[:1]]


USER_FILES: set[str] = set()  # that define families from outside this package


def user_fault(error: BaseException) -> str | None:
    """Returns one line about an error that a user's file raised, with its last line there; None for other errors."""
    place = user_place(error)
    return None if place is None else f"{first_line(error)}{place}"


def user_place(error: BaseException) -> str | None:
    """Returns the last line of a user's code that an error came through, as ` (fam.py, line 3, in reward)`.

    A user's code is the files of families from outside this package and their neighbours; None if the error did not
    come through any.
    """
    folders = {os.path.dirname(file) for file in USER_FILES}
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if os.path.dirname(frame.filename) in folders]
    return f" ({os.path.basename(own[-1].filename)}, line {own[-1].lineno}, in {own[-1].name})" if own else None


def first_line(error: BaseException) -> str:
    """Returns an error's type and the first line of its message."""
    return f"{type(error).__name__}: {error}".splitlines()[0].removesuffix(": ")


def plain(text: str) -> str:
    """Returns a text whose control characters, which a terminal would obey, are spelt out."""
    return "".join(letter if letter.isprintable() else repr(letter)[1:-1] for letter in text)
