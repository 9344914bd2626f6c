"""The last steps of an analysis command: keep its document, draw the figures and print both."""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from rich.cells import cell_len

from ear_jax.errors import plain
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


def print_table(headings: Sequence[str], rows: Iterable[Sequence[str]], title: str | None = None) -> None:
    """Prints a table of plain text, in which no cell is markup or cut off.

    A heading that ends in `>` aligns its column to the right. If the terminal is too narrow, each row becomes a
    paragraph with a line for each cell.
    """
    names = [heading.removesuffix(">") for heading in headings]
    right = [heading.endswith(">") for heading in headings]
    cells = [names, *([plain(cell) for cell in row] for row in rows)]
    widths = [max(map(cell_len, column)) for column in zip(*cells, strict=True)]
    if title:
        print(plain(title))
    if sys.stdout.isatty() and sum(widths) + 3 * (len(widths) - 1) > shutil.get_terminal_size().columns:
        for first, *others in cells[1:]:
            print("\n".join([first, *(f"  {name}: {cell}" for name, cell in zip(names[1:], others, strict=True))]))
        return
    for number, row in enumerate(cells):
        padded = (" " * (width - cell_len(cell)) for cell, width in zip(row, widths, strict=True))
        filled = (blank + cell if end else cell + blank for cell, blank, end in zip(row, padded, right, strict=True))
        print("   ".join(filled).rstrip())
        if number == 0:
            print("─" * (sum(widths) + 3 * (len(widths) - 1)))
