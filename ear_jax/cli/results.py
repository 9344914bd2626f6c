"""The last steps of an analysis command: print its document, keep it and draw the figures."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import re
import shutil
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from rich.cells import cell_len

from ear_jax.errors import RunError, plain
from ear_jax.process.terminal import say
from ear_jax.runs import records

Draw = Callable[[Path, dict[str, Any], str], list[Path]]  # figures folder, document, label → paths of the figures
UNLABELLED = ("run", "family", "json", "save", "film")  # options that change neither numbers nor pictures
LONGEST = 100  # letters of a label


def label_of(command: Any, without: Sequence[str] = ()) -> str:
    """Returns the part of a file's name that tells apart the outputs of one command: its options besides the defaults.

    The same options give the same label, as in `_between-2-3_target-2.5`; without any it is empty. A long label is cut
    short, and its hash added.

    Args:
      command: the parsed command line.
      without: options that the file's name already tells.
    """
    parts = []
    for field in dataclasses.fields(command):
        value = getattr(command, field.name)
        default = None if field.default is dataclasses.MISSING else field.default
        if value != default and field.name not in (*UNLABELLED, *without):
            words = value if isinstance(value, tuple) else () if value is True else (value,)
            parts.append("-".join(map(str, ("random" if field.name == "seed" else field.name, *words))))
    whole = "".join(f"_{part}" for part in parts)
    safe = re.sub(r"[^\w.+-]+", "-", whole)
    return safe if safe == whole and len(safe) <= LONGEST else f"{safe[:LONGEST]}-{short_hash(whole)}"


def short_hash(text: str) -> str:
    """Returns eight letters that tell a text from others."""
    return hashlib.sha256(text.encode(errors="surrogateescape")).hexdigest()[:8]


def check_writable(directory: Path) -> None:
    """Raises RunError if files cannot be written in a directory; a command whose result is a file asks before it works.

    The directory itself may not exist yet.
    """
    existing = next(path for path in (directory, *directory.absolute().parents) if path.exists())
    if not (existing.is_dir() and os.access(existing, os.W_OK | os.X_OK)):
        raise RunError(f"cannot write in {existing}")


def keep(run: Path, name: str, label: str, document: dict[str, Any], draw: Draw) -> list[Path]:
    """Writes a document with its provenance into a run's directory, and draws its figures; returns their paths.

    Raises:
      RunError: they cannot be written.
    """
    records.write_json(run / f"{name}{label}.json", {**document, **records.provenance()})
    return draw(run / "figures", document, label)


def show_and_keep(
    document: dict[str, Any],
    as_json: bool,
    print_text: Callable[[dict[str, Any]], None],
    keep: Callable[[], list[Path]],
) -> None:
    """Prints a document, keeps it, and prints the paths of its figures; warns if it cannot be kept.

    It is kept though nobody reads what is printed; the error of printing is raised afterwards.

    Args:
      document: the results.
      as_json: print one JSON document, which holds the paths as `figures`.
      print_text: prints the document otherwise.
      keep: writes the results and returns the paths of the figures.
    """
    unread = None
    try:
        if not as_json:
            print_text(document)
            sys.stdout.flush()
    except OSError as error:
        unread = error
    try:
        pictures = keep()
    except (RunError, OSError) as error:
        say(f"warning: these results are not kept: {error}")
        pictures = []
    if unread:
        raise unread
    if as_json:
        print(json.dumps({**document, "figures": [str(path) for path in pictures]}))
    else:
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
