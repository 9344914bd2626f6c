"""Agents that ship with the package: NAME.safetensors and its card NAME.json. Imports no JAX.

Commands accept `pretrained:NAME` in place of a run, which `trained.load` resolves. `python -m experiments publish`
writes the cards: training settings, results and the file's SHA-256.
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

from ear_jax.errors import RunError, known_name
from ear_jax.files.documents import read_json

PREFIX = "pretrained:"
SUFFIX = ".safetensors"  # of the files of policies
FOLDER = Path(__file__).parent
NEW = ".new"  # ends the name of a file whose card is written before the file gets its own name


def names() -> list[str]:
    """Returns the names of all agents, sorted."""
    return sorted(path.stem for path in FOLDER.glob("*.json"))


def card(name: str) -> dict[str, Any]:
    """Returns an agent's card.

    Raises:
      UsageError: there is no such agent.
      RunError: its card cannot be read.
    """
    path = FOLDER / f"{known_name('pretrained agent', name, names())}.json"
    document = read_json(path)
    if not isinstance(document.get("sha256"), str):
        raise RunError(f"{path} cannot be read: 'sha256' is not a string")
    return document


def find(name: str) -> Path:
    """Returns the path of an agent's file after comparing its SHA-256 with the card's.

    Raises:
      UsageError: there is no such agent.
      RunError: the file cannot be read, or differs from its card.
    """
    path = FOLDER / f"{known_name('pretrained agent', name, names())}{SUFFIX}"
    new = path.with_name(path.name + NEW)
    expected = card(name)["sha256"]
    if new.exists() and _digest(new) == expected:
        return new
    if _digest(path) != expected:
        raise RunError(f"{path} is not the file that shipped: its SHA-256 differs from its card's")
    return path


def _digest(path: Path) -> str:
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise RunError(f"cannot read {path}: {error.strerror}") from None


def results(name: str) -> Path:
    """Returns the directory of an agent's analyses, under the working directory as the package may be read-only."""
    return Path("runs") / f"pretrained-{known_name('pretrained agent', name, names())}"
