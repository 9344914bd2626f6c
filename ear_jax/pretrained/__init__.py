"""Trained agents that ship with the package: NAME.safetensors and beside it NAME.json, its card. Imports no JAX.

`pretrained:NAME` stands wherever a command takes a run; `trained.load` is where it is resolved. A card is written by
`python -m experiments publish` and tells how the agent was trained, what it reaches, and the file's SHA-256.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

from ear_jax.errors import RunError, unknown

PREFIX = "pretrained:"
FOLDER = Path(__file__).parent


def names() -> list[str]:
    """The agents there are, in the order of the alphabet."""
    return sorted(path.stem for path in FOLDER.glob("*.json"))


def card(name: str) -> dict[str, Any]:
    """An agent's card.

    Raises:
      UsageError: there is no such agent.
      RunError: its card cannot be read.
    """
    if name not in names():
        raise unknown("pretrained agent", name, names())
    path = FOLDER / f"{name}.json"
    try:
        document = json.loads(path.read_bytes())
        if not isinstance(document["sha256"], str):
            raise ValueError("'sha256' is no text")
        return document
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise RunError(f"{path} cannot be read: {error}") from None


def find(name: str) -> Path:
    """An agent's file, once it is known to be the one that its card tells of.

    Raises:
      UsageError: there is no such agent.
      RunError: the file cannot be read, or differs from its card.
    """
    path = FOLDER / f"{name}.safetensors"
    expected = card(name)["sha256"]
    try:
        found = hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise RunError(f"cannot read {path}: {error.strerror}") from None
    if found != expected:
        raise RunError(f"{path} is not the file that shipped: its SHA-256 differs from its card's")
    return path


def results(name: str) -> Path:
    """Where what is found out about an agent is kept: under the working directory, as the package may be read-only."""
    return Path("runs") / f"pretrained-{name}"
