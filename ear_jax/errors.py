"""The two ways a command fails for a reason its user can mend, and the nearest real name to a mistyped one."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class UsageError(Exception):
    """What was asked for makes no sense; one line says what would. Exit code 2."""


class RunError(Exception):
    """What was asked for makes sense and cannot be done here; one line says why. Exit code 1."""


def unknown(kind: str, word: str, known: Iterable[str]) -> UsageError:
    """The error for a name that does not exist: the nearest that does, and all of them."""
    known = sorted(known)
    near = difflib.get_close_matches(word.lower(), known, n=1, cutoff=0.4)
    guess = f"; did you mean {near[0]!r}?" if near else ""
    return UsageError(f"unknown {kind} {word!r}{guess} (there are: {', '.join(known) or 'none'})")
