"""Plain words: openings of docstrings, and obscure sentences that must not come back."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SOURCES = ("ear_jax", "experiments", "benchmarks", "tests")
QUESTIONS = {"What", "Where", "How", "Whether", "Which"}
TEXTS = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
TEXTS += [path for source in SOURCES[:3] for path in (ROOT / source).rglob("*.py")]
GONE = (  # the left column of the table of sentences in issue 28, as patterns
    r"What all critics' values come to",
    r"so-manieth",
    r"What a number has to be read with",
    r"is none of the run's",
    r"Return does not tell\b",
    r"Denied its AMX",
    r"whose learnt task embeddings are then a control interface",
    r"where that is short of the paper, stands below",
    r"had an episode of \S+ that ended before",
)


def docstrings(path: Path) -> Iterator[tuple[int, str]]:
    """Yields the line and text of each docstring of a file: of the module, its classes, functions and fields."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ClassDef):
            fields = [entry.value for entry in node.body[1:] if isinstance(entry, ast.Expr)]
            yield from ((entry.lineno, entry.value) for entry in fields if isinstance(entry, ast.Constant))
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            text = ast.get_docstring(node)
            if text:
                yield getattr(node, "lineno", 1), text


@pytest.mark.parametrize("source", SOURCES)
def test_no_docstring_opens_with_a_question_word(source):
    found = [
        f"{path.relative_to(ROOT)}:{line}: {text.splitlines()[0]}"
        for path in sorted((ROOT / source).rglob("*.py"))
        for line, text in docstrings(path)
        if re.split(r"\W", text, maxsplit=1)[0] in QUESTIONS
    ]
    assert not found, "\n".join(["begin with a verb or a noun phrase:", *found])


def in_one_line(path: Path) -> str:
    """Returns a file's text without line breaks, also where one sentence is several strings or comment lines."""
    text = re.sub(r"\"\s*\n\s*f?\"", "", path.read_text())
    return " ".join(re.sub(r"\n\s*#", "\n", text).split())


@pytest.mark.parametrize("pattern", GONE)
def test_a_riddle_that_was_rewritten_stays_gone(pattern):
    found = [str(path.relative_to(ROOT)) for path in TEXTS if re.search(pattern, in_one_line(path))]
    assert not found
