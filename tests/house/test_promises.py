"""The tests that `docs/reliability.md` names behind its guarantees are there."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
NAMED = re.compile(r"`((?:tests/|test_|…)[^`\s]*)`")


def promises() -> Iterator[tuple[str, str, str]]:
    """Yields each test that the page names: its line, its file, and its name, in which … stands for any letters.

    Before `::`, … is the file named last. A name without a file is of the file in the heading of its table, if there is
    one, and else of the file named last.
    """
    folder = file = last = ""
    for line in (ROOT / "docs" / "reliability.md").read_text().splitlines():
        tokens = [token for token in NAMED.findall(line) if "::" in token or not token.startswith("tests/")]
        if line.startswith("## "):
            folder, file = "tests/runs", ""
        if "| test" in line:  # the heading of a table
            folder = next((token.rstrip("/") for token in NAMED.findall(line) if token.startswith("tests/")), folder)
            file = next((f"{folder}/{token}" for token in tokens), "")
            continue
        for token in [token for token in NAMED.findall(line) if token.endswith(".py") or token in tokens]:
            place, _, name = token.rpartition("::") if "::" in token or not token.endswith(".py") else (token, "", "")
            if place not in ("", "…"):
                last = place if place.startswith("tests/") else f"{folder}/{place}"
            yield line, last if place or name.startswith("…") else file or last, name


def names_in(file: str) -> list[str]:
    """Returns the names of a file's tests."""
    nodes = ast.walk(ast.parse((ROOT / file).read_text()))
    return [node.name for node in nodes if isinstance(node, ast.FunctionDef) and node.name.startswith("test_")]


def test_every_test_that_is_named_is_there():
    named = list(promises())
    assert len(named) > 80
    for line, file, name in named:
        assert (ROOT / file).is_file(), f"{file} in: {line}"
        pattern = ".*".join(map(re.escape, name.split("…"))) or ".*"
        assert any(re.fullmatch(pattern, test) for test in names_in(file)), f"{file}::{name} in: {line}"


def test_every_guarantee_names_a_test():
    """But for the level of reproducibility that guarantees nothing."""
    rows = [line for line in (ROOT / "docs" / "reliability.md").read_text().splitlines() if line.startswith("| ")]
    bare = [row for row in rows if not NAMED.search(row) and "| test" not in row]
    assert [row[:5] for row in bare] == ["| R2 "]
