"""JSON documents with a checksum among their keys, so that a flipped bit cannot pass for a number.

The checksum is over the other keys and their values, whatever the layout. Documents of earlier versions have none and
are read as they are.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any, NoReturn

from ear_jax.errors import RunError
from ear_jax.files.replacing import write_text

KEY = "checksum"


def write_json(path: Path, document: dict[str, Any]) -> None:
    """Replaces a JSON document; raises RunError if it cannot be written, or has a number that is not finite."""
    try:
        text = json.dumps(signed(document), indent=2, allow_nan=False)
    except ValueError as error:
        raise RunError(f"cannot write {path}: {error}") from None
    write_text(path, text + "\n")


def read_json(path: Path) -> dict[str, Any]:
    """Reads a JSON document and returns it without its checksum.

    Raises:
      RunError: it cannot be read, is no table of names and values, or differs from its checksum.
    """
    try:
        return verified(parse(path.read_text(encoding="utf-8")))
    except OSError as error:
        raise RunError(f"{path} cannot be read: {error.strerror}") from None
    except Damaged as error:
        raise RunError(f"{path} is damaged: {error}") from None
    except ValueError as error:
        raise RunError(f"{path} cannot be read: {error}") from None


class Damaged(ValueError):
    """A document or row differs from its checksum."""


def parse(text: str) -> dict[str, Any]:
    """Returns the JSON object that a text holds; raises ValueError for any other text, however it is nested."""
    try:
        document = json.loads(text, parse_constant=_refuse)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
    if not isinstance(document, dict):
        raise ValueError("it is no table of names and values")
    return document


def signed(document: dict[str, Any]) -> dict[str, Any]:
    """Returns a document with its checksum as the last key."""
    plain = {name: value for name, value in document.items() if name != KEY}
    return {**plain, KEY: _checksum(plain)}


def verified(document: dict[str, Any]) -> dict[str, Any]:
    """Returns a document without its checksum; raises Damaged if it differs from it."""
    plain = {name: value for name, value in document.items() if name != KEY}
    if KEY in document and document[KEY] != _checksum(plain):
        raise Damaged("it differs from its checksum")
    return plain


def _checksum(document: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(document, sort_keys=True).encode()).hexdigest()[:16]


def _refuse(constant: str) -> NoReturn:
    raise ValueError(f"{constant} is no number of JSON")
