"""Errors that a command reports in one line, and suggestions for mistyped names."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class UsageError(Exception):
    """The request is invalid; one line says what is allowed. Exit code 2."""


class RunError(Exception):
    """The request is valid but cannot be carried out here; one line says why. Exit code 1."""


def unknown(kind: str, word: str, known: Iterable[str]) -> UsageError:
    """Returns the error for an unknown name; it suggests the nearest known name and lists all of them."""
    known = sorted(known)
    nearest = difflib.get_close_matches(word.lower(), known, n=1, cutoff=0.4)
    hint = f"; did you mean {nearest[0]!r}?" if nearest else ""
    return UsageError(f"unknown {kind} {word!r}{hint} (there are: {', '.join(known) or 'none'})")
