"""A run's directory, and whether a run may go there: told before anything slow, and before anything is written."""

from __future__ import annotations

import json
import os
from itertools import zip_longest
from pathlib import Path
from typing import Any

from ear_jax.config import Config, flat, from_dict, run_name
from ear_jax.errors import RunError, UsageError
from ear_jax.tasks import TaskSet

# Settings that may differ when a run is continued: none of them changes what an epoch computes.
MAY_CHANGE = ("epochs", "minutes", "engine", "checkpoint.blocks", "checkpoint.replay")
# What a process leaves that was killed before it wrote config.json.
BEGINNINGS = {"lock", "config.json.part"}


def default_directory(config: Config) -> Path:
    return Path("runs") / run_name(config)


def check_place(directory: Path) -> None:
    """Refuses a directory that cannot hold a run.

    Raises:
      UsageError: it is a file, or holds something else.
      RunError: it cannot be written.
    """
    standing = next(path for path in (directory, *directory.absolute().parents) if path.exists())
    if not standing.is_dir():
        raise UsageError(f"--out {directory} needs a directory, and {standing} is a file")
    if not os.access(standing, os.W_OK | os.X_OK):
        raise RunError(f"cannot write in {standing}")
    names = {path.name for path in directory.iterdir()} if directory.exists() else set()
    if "config.json" not in names and not names <= BEGINNINGS:
        raise UsageError(f"--out {directory} is neither empty nor a run directory; name another")


def check_settings(holder: Path, document: dict[str, Any], config: Config) -> None:
    """Refuses to continue a run with other settings.

    Args:
      holder: the run or checkpoint that `document` was read from.
      document: what it says of itself.
      config: what is to be trained now.

    Raises:
      UsageError: settings differ, with the differences.
    """
    before, now = flat(from_dict(document["config"])), flat(config)
    differ = [name for name in before if before[name] != now[name] and name not in MAY_CHANGE]
    if differ:
        changes = "; ".join(f"{name} was {before[name]}, is {now[name]}" for name in differ)
        raise UsageError(f"{holder} holds a run with other settings: {changes}; use another --out")


def check_tasks(holder: Path, document: dict[str, Any], tasks: TaskSet) -> None:
    """Refuses to use what was trained on one set of tasks with another; raises UsageError with the first difference."""
    if document.get("fingerprint") == tasks.fingerprint:
        return
    pairs = zip_longest(document.get("tasks", []), json.loads(json.dumps(tasks.document)))
    old, new = next((pair for pair in pairs if pair[0] != pair[1]), ("a task", "another"))
    raise UsageError(f"{holder} was trained on other tasks: {old} is now {new}")
