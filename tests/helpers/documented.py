"""The keys of JSON documents, held against those that `docs/documents.md` has."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

DOCUMENT = Path(__file__).parents[2] / "docs" / "documents.md"
MAY_BE_MISSING = ("may be missing", "only of profiles", "the command only")


def check_keys(section: str, document: dict[str, Any]) -> None:
    """Asserts that a document has the keys of its section, no others, and is JSON."""
    (rows,) = re.findall(rf"^## {section}\n(.*?)(?=^## |\Z)", DOCUMENT.read_text(), re.MULTILINE | re.DOTALL)
    keys = {
        key: any(words in content for words in MAY_BE_MISSING)
        for names, content in re.findall(r"^\| (`.*?`) \| (.*) \|$", rows, re.MULTILINE)
        for key in re.findall(r"`([^`]+)`", names)
    }
    found = set(_paths(json.loads(json.dumps(document)), keys))
    assert found <= set(keys), f"not in {DOCUMENT.name}: {found - set(keys)}"
    assert {key for key, may_miss in keys.items() if not may_miss} <= found, set(keys) - found


def _paths(value: Any, keys: dict[str, bool], at: str = "") -> Iterator[str]:
    """Yields the keys of a document, down to those that are told of as a whole."""
    if at in keys:
        yield at
    elif isinstance(value, dict):
        for name, part in value.items():
            yield from _paths(part, keys, f"{at}.{name}" if at else name)
    elif isinstance(value, list):
        for part in value:
            yield from _paths(part, keys, f"{at}[]")
    else:
        yield at
