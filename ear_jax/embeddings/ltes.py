"""Named LTEs: those that `ear adapt --save` keeps in the run's directory for other commands. Imports no JAX."""

from __future__ import annotations

import re
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ear_jax.errors import RunError, UsageError, unknown
from ear_jax.files.documents import KEY
from ear_jax.files.replacing import lock_file
from ear_jax.runs import records

FILE = "ltes.json"
NAME = r"[A-Za-z][\w.-]*"
LARGEST = 1e9  # a number of an LTE; float32 holds its square


def save(
    run: Path, name: str, task: str, codes: Sequence[Sequence[float]], policy: str, asked_by: str = "--target"
) -> None:
    """Saves one LTE per seed under a name, replacing any of the same name.

    Args:
      run: the run's directory.
      name: the name.
      task: the task or the reward that the LTEs were found for.
      codes: the LTEs [seeds, code].
      policy: the fingerprint of the policies that they were found for.
      asked_by: the option of `ear adapt` that names it, --target or --reward.

    Raises:
      UsageError: the name could be mistaken for a number or an option.
    """
    check_name(name)
    entry = {"task": task, "asked_by": asked_by, "policy": policy, "codes": [list(code) for code in codes]}
    with lock_file(run / FILE):
        records.write_json(run / FILE, {**saved(run), name: entry})


def check_name(name: str) -> None:
    """Raises UsageError for a name that could be mistaken for a number or an option."""
    if name == KEY:
        raise UsageError(f"{name!r} cannot name an LTE: {FILE} uses that name itself")
    if not re.fullmatch(NAME, name):
        raise UsageError(f"{name!r} cannot name an LTE: begin with a letter, then use letters, digits, '.', '-' or '_'")


def saved(run: Path) -> dict[str, Any]:
    """Reads a run's named LTEs: for each the task and the policy it was found for, and its codes [seeds, code].

    Raises:
      RunError: the file cannot be read.
    """
    path = run / FILE
    known = records.read_json(path) if path.exists() else {}
    for name, entry in known.items():
        if not _is_entry(entry):
            raise RunError(f"{path} cannot be read: {name!r} is not a task and its LTEs")
    return known


def _is_entry(entry: Any) -> bool:
    if not (isinstance(entry, dict) and isinstance(entry.get("task"), str) and isinstance(entry.get("codes"), list)):
        return False
    return bool(entry["codes"]) and all(isinstance(code, list) and _has_direction(code) for code in entry["codes"])


def _has_direction(code: list[Any]) -> bool:
    """Returns whether a code is of numbers that have a direction also in float32."""
    if not all(isinstance(number, int | float) and abs(number) <= LARGEST for number in code):
        return False
    return any(abs(number) >= 1 / LARGEST for number in code)


def find(run: Path, words: Sequence[str], seeds: int, size: int, policy: str) -> list[list[float]]:
    """Returns codes [seeds, size] for the words after --lte: the name of a saved LTE, or numbers used for every seed.

    Raises:
      UsageError: an unknown name, an LTE of another policy, or numbers that have no direction.
    """
    if len(words) == 1 and re.fullmatch(NAME, words[0]):
        codes = lookup(run, words[0], policy)["codes"]
        if len(codes) != seeds or any(len(code) != size for code in codes):
            raise UsageError(f"LTE {words[0]!r} was found for another run: its codes are not {seeds} of {size} numbers")
        return codes
    try:
        code = [float(word) for word in words]
    except ValueError:
        raise UsageError(f"--lte {' '.join(words)} is neither a name nor {size} numbers") from None
    if len(code) != size:
        raise UsageError(f"--lte has {len(code)} numbers; this run's LTEs have {size}")
    if not _has_direction(code):
        given = " ".join(words)
        raise UsageError(f"--lte {given} has no direction; its numbers must be below {LARGEST:g} and not all 0")
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
        asked_by = known[name].get("asked_by", "--target")
        again = f"run `ear adapt RUN {asked_by} {shlex.quote(known[name]['task'])} --save {name}` again"
        raise UsageError(f"LTE {name!r} was found for another policy, for example before more training; {again}")
    return known[name]
