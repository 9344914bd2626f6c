"""The last steps of an analysis command: keep its document, draw the figures and print both."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from ear_jax.runs import records

Draw = Callable[[Path, dict[str, Any]], list[Path]]  # figures folder, document → paths of the figures


def keep(run: Path, file: str, document: dict[str, Any], draw: Draw) -> list[Path]:
    """Writes a document with its provenance into a run's directory, and draws its figures; returns their paths."""
    records.write_json(run / file, {**document, **records.provenance()})
    return draw(run / "figures", document)


def print_result(
    document: dict[str, Any], pictures: list[Path], as_json: bool, print_text: Callable[[dict[str, Any]], None]
) -> None:
    """Prints a document with the paths of its figures, as JSON or by `print_text`."""
    if as_json:
        print(json.dumps({**document, "figures": [str(path) for path in pictures]}))
        return
    print_text(document)
    print_pictures(pictures)


def print_pictures(pictures: Iterable[Path]) -> None:
    """Prints the paths of pictures on one line; prints nothing if there are none."""
    if paths := ", ".join(map(str, pictures)):
        print(f"pictures: {paths}")
