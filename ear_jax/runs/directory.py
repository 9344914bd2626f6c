"""A run's directory and the checks of it, made before anything slow starts or is written."""

from __future__ import annotations

import json
import os
import re
import reprlib
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ear_jax.config import Config, flat, from_dict, run_name
from ear_jax.errors import RunError, UsageError

if TYPE_CHECKING:
    from ear_jax.tasks import TaskSet

# Settings that may change when a run is continued, as they do not affect what an epoch computes.
MAY_CHANGE = ("epochs", "minutes", "engine", "checkpoint.blocks", "checkpoint.replay", "log.tensorboard", "log.wandb")
FOLDER = "checkpoints"
LONGEST_PATH = 3500  # bytes; Linux allows 4096, and a checkpoint's files have long names
# Files that a process leaves if it is killed before it wrote config.json, or a sweep's document.
UNSTARTED = r"lock|config\.json\.part|\.(config|sweep)\.json\.[0-9a-f]+\.part"


def default_directory(config: Config) -> Path:
    """Returns the directory of a run whose user named none."""
    return Path("runs") / run_name(config)


def check_place(directory: Path) -> None:
    """Checks that a directory can hold a run.

    Raises:
      UsageError: it is a file, or holds something else.
      RunError: it is not writable.
    """
    check_path(directory)
    existing = next(path for path in (directory, *directory.absolute().parents) if path.exists())
    if not existing.is_dir():
        raise UsageError(f"--out {directory} needs a directory, but {existing} is a file")
    if not os.access(existing, os.W_OK | os.X_OK):
        raise RunError(f"cannot write in {existing}")
    checkpoints = directory / FOLDER
    if checkpoints.is_symlink() and not checkpoints.exists():
        raise RunError(f"{checkpoints} is a link to {os.readlink(checkpoints)}, which is not there: mount or remove it")
    if checkpoints.exists() and not (checkpoints.is_dir() and os.access(checkpoints, os.W_OK | os.X_OK)):
        raise RunError(f"{checkpoints} is not a directory that can be written; move it away")
    names = {path.name for path in directory.iterdir()} if directory.exists() else set()
    if not is_run(directory) and not all(re.fullmatch(UNSTARTED, name) for name in names):
        raise UsageError(f"--out {directory} is neither empty nor a run directory; name another")


def is_run(directory: Path) -> bool:
    """Returns whether a directory holds a run, whose config.json may be lost."""
    return (directory / "config.json").is_file() or bool(steps(directory / FOLDER))


def steps(directory: Path) -> list[int]:
    """Returns the epochs of all finished steps, ascending, including damaged ones."""
    if not directory.is_dir():
        return []
    named = (path for path in directory.iterdir() if re.fullmatch(r"0|[1-9][0-9]*", path.name))
    return sorted(int(path.name) for path in named if path.is_dir() and not path.is_symlink())


def check_path(path: Path) -> None:
    """Raises UsageError for a path that checkpoints cannot have: one that is not UTF-8, or too long for their names."""
    whole = os.fsencode(path.absolute())
    try:
        whole.decode()
    except UnicodeDecodeError:
        raise UsageError(f"{str(path.absolute())!a} is not UTF-8, as paths of runs must be; name another") from None
    if len(whole) > LONGEST_PATH:
        raise UsageError(f"{path} has {len(whole)} bytes, too many for the files of a run; name a shorter path")


def check_settings(holder: Path, document: dict[str, Any], config: Config) -> None:
    """Checks that a run is continued with its own settings.

    Args:
      holder: the run or checkpoint that `document` was read from.
      document: its `config.json` or `about.json`.
      config: the settings to train with now.

    Raises:
      UsageError: settings differ; the message lists them.
    """
    before, now = flat(from_dict(document["config"])), flat(config)
    changed = [name for name in before if before[name] != now[name] and name not in MAY_CHANGE]
    if changed:
        changes = "; ".join(f"{name} was {before[name]}, is {now[name]}" for name in changed)
        raise UsageError(f"{holder} holds a run with other settings: {changes}; use another --out")


def check_tasks(holder: Path, document: dict[str, Any], tasks: TaskSet) -> None:
    """Raises UsageError with the first difference if a run or file was trained on other tasks."""
    if document.get("fingerprint") == tasks.fingerprint:
        return
    pairs = zip_longest(document.get("tasks", []), json.loads(json.dumps(tasks.document)))
    old, new = next((pair for pair in pairs if pair[0] != pair[1]), ("a task", "another"))
    raise UsageError(f"{holder} was trained on other tasks: {reprlib.repr(old)} is now {reprlib.repr(new)}")
