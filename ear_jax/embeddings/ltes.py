"""LTEs with names: what an adaptation found, kept beside its run for every other command. Imports no JAX."""

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
    """Keeps one LTE a seed, found for a task and a policy (its fingerprint), under a name; an older one gives way.

    Raises:
      UsageError: a name that could be mistaken for a number or an option.
    """
    check_name(name)
    found = {"task": task, "policy": policy}
    records.write_json(run / FILE, {**saved(run), name: {**found, "codes": [list(code) for code in codes]}})


def check_name(name: str) -> None:
    if not re.fullmatch(NAME, name):
        raise UsageError(f"{name!r} cannot name an LTE; begin with a letter and go on with letters, digits, . - or _")


def saved(run: Path) -> dict[str, Any]:
    """Every named LTE of a run: the task and the policy it was found for, and its codes [seeds, code].

    Raises:
      RunError: the file cannot be read.
    """
    path = run / FILE
    try:
        return json.loads(path.read_text()) if path.exists() else {}
    except ValueError as error:
        raise RunError(f"{path} cannot be read: {error}") from None


def find(run: Path, words: Sequence[str], seeds: int, size: int, policy: str) -> list[list[float]]:
    """Codes [seeds, size] from what a person gives: the name of a saved LTE, or the numbers of one for all seeds.

    Raises:
      UsageError: no such name, or one of another policy, or numbers that are no direction.
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
    """A saved LTE: its task and codes [seeds, code].

    Raises:
      UsageError: there is none, or it was found for another policy, as before a run was continued.
    """
    known = saved(run)
    if not known:
        raise UsageError(f"no LTE {name!r}: {run} has none (`ear adapt RUN --target X --save NAME` saves one)")
    if name not in known:
        raise unknown("LTE", name, known)
    if known[name].get("policy", policy) != policy:  # earlier versions did not keep it
        again = f"`ear adapt RUN --target {known[name]['task']} --save {name}` finds it anew"
        raise UsageError(f"LTE {name!r} was found for another policy than this one, as before more training; {again}")
    return known[name]
