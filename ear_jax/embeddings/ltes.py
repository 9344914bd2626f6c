"""Named LTEs: those that `ear adapt --save` keeps in the run's directory for other commands. Imports no JAX."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ear_jax.errors import RunError, UsageError, unknown
from ear_jax.runs import records

FILE = "ltes.json"
NAME = r"[A-Za-z][\w.-]*"


def save(run: Path, name: str, task: str, codes: Sequence[Sequence[float]], policy: str) -> None:
    """Saves one LTE per seed under a name, replacing any of the same name.

    Args:
      run: the run's directory.
      name: the name.
      task: the task that the LTEs were found for.
      codes: the LTEs [seeds, code].
      policy: the fingerprint of the policies that they were found for.

    Raises:
      UsageError: the name could be mistaken for a number or an option.
    """
    check_name(name)
    entry = {"task": task, "policy": policy, "codes": [list(code) for code in codes]}
    records.write_json(run / FILE, {**saved(run), name: entry})


def check_name(name: str) -> None:
    """Raises UsageError for a name that could be mistaken for a number or an option."""
    if not re.fullmatch(NAME, name):
        raise UsageError(f"{name!r} cannot name an LTE: begin with a letter, then use letters, digits, '.', '-' or '_'")


def saved(run: Path) -> dict[str, Any]:
    """Reads a run's named LTEs: for each the task and the policy it was found for, and its codes [seeds, code].

    Raises:
      RunError: the file cannot be read.
    """
    path = run / FILE
    try:
        return json.loads(path.read_text()) if path.exists() else {}
    except ValueError as error:
        raise RunError(f"{path} cannot be read: {error}") from None


def find(run: Path, words: Sequence[str], seeds: int, size: int, policy: str) -> list[list[float]]:
    """Returns codes [seeds, size] for the words after --lte: the name of a saved LTE, or numbers used for every seed.

    Raises:
      UsageError: an unknown name, an LTE of another policy, or numbers that have no direction.
    """
    if len(words) == 1 and re.fullmatch(NAME, words[0]):
        return lookup(run, words[0], policy)["codes"]
    try:
        code = [float(word) for word in words]
    except ValueError:
        raise UsageError(f"--lte {' '.join(words)} is neither a name nor {size} numbers") from None
    if len(code) != size:
        raise UsageError(f"--lte has {len(code)} numbers; this run's LTEs have {size}")
    if not (all(map(math.isfinite, code)) and any(code)):
        raise UsageError(f"--lte {' '.join(words)} has no direction; its numbers must be finite and not all 0")
    return [code] * seeds


def lookup(run: Path, name: str, policy: str) -> dict[str, Any]:
    """Returns a saved LTE: its task and its codes [seeds, code].

    Raises:
      UsageError: an unknown name, or an LTE of another policy, such as the run's policy before more training.
    """
    known = saved(run)
    if not known:
        raise UsageError(f"unknown LTE {name!r}: {run} has none (`ear adapt RUN --target X --save NAME` saves one)")
    if name not in known:
        raise unknown("LTE", name, known)
    if known[name].get("policy", policy) != policy:  # files of earlier versions do not name the policy
        again = f"run `ear adapt RUN --target {known[name]['task']} --save {name}` again"
        raise UsageError(f"LTE {name!r} was found for another policy, for example before more training; {again}")
    return known[name]
