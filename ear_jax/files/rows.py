"""Files of JSON lines that only grow, such as `metrics.jsonl`: every row has a checksum of its own."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from ear_jax.errors import RunError
from ear_jax.files.documents import KEY, parse, signed, verified

Warn = Callable[[str], None]
Keys = Mapping[str, type | tuple[type, ...]]  # name → type of the value
NO_KEYS: Keys = {}
LAST = 1 << 16  # bytes in which a last row is looked for


def append_rows(path: Path, rows: list[dict[str, Any]]) -> str:
    """Appends JSON lines, flushes them to disk (fsync) and returns them; raises RunError if they cannot be written."""
    lines = "".join(json.dumps(signed(row), allow_nan=False) + "\n" for row in rows)
    try:
        file = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_NOFOLLOW, 0o644)
        with os.fdopen(file, "w", encoding="utf-8") as stream:
            stream.write(lines)
            stream.flush()
            os.fsync(file)
    except OSError as error:
        raise RunError(f"cannot write {path}: {error.strerror}") from None
    return lines


def read_rows(path: Path, warn: Warn | None = None, required: Keys = NO_KEYS) -> list[dict[str, Any]]:
    """Returns all rows, without their checksums; a last line that is cut off is skipped.

    Args:
      path: the file; a missing one has no rows, nor has one under a file in place of a directory.
      warn: called with a line for each damaged row, which is then skipped.
      required: the keys that every row has, and the types of their values.

    Raises:
      RunError: the file cannot be read, or a row is damaged and `warn` is not given.
    """
    try:
        text = path.read_text(encoding="utf-8", errors="replace")
    except (FileNotFoundError, NotADirectoryError):
        return []
    except OSError as error:
        raise RunError(f"{path} cannot be read: {error.strerror}") from None
    return [row for _, row in lines_of(text, path, warn, required) if row is not None]


def last_row(path: Path) -> dict[str, Any] | None:
    """Returns the last good row among a file's last bytes, for a view of a file that grows; None if there is none."""
    try:
        with path.open("rb") as file:
            file.seek(max(0, os.fstat(file.fileno()).st_size - LAST))
            text = file.read().decode(errors="replace")
    except OSError:
        return None
    rows = [row for _, row in lines_of(text, path, lambda _: None) if row is not None]
    return rows[-1] if rows else None


def lines_of(
    text: str, path: Path, warn: Warn | None = None, required: Keys = NO_KEYS
) -> Iterator[tuple[str, dict[str, Any] | None]]:
    """Yields each line of a text, with its end, and its row, None for a damaged one.

    Args:
      text: the content of a file.
      path: its name, for messages.
      warn, required: as of `read_rows`.

    Raises:
      RunError: a row is damaged, and `warn` is not given.
    """
    lines = text.split("\n")  # and not at other characters that end a line, which a flipped bit may make
    checked = False
    for number, line in enumerate(lines, start=1):
        if number == len(lines) and _is_cut_off(line):
            continue
        try:
            document = parse(line)
            if checked and KEY not in document:
                raise ValueError("it has no checksum")
            row, checked = verified(document), KEY in document
            for name, kind in required.items():
                if not isinstance(row.get(name), kind):
                    raise ValueError(f"its {name!r} is missing, or of another type")
            yield line + "\n", row
        except ValueError as error:
            fault = f"{path} is damaged: line {number}: {error}"
            if warn is None:
                raise RunError(fault) from None
            warn(f"warning: {fault}; it is skipped")
            yield line + "\n", None


def _is_cut_off(line: str) -> bool:
    """Returns whether the rest of a file after its last complete line is empty, or the beginning of a row."""
    try:
        json.JSONDecoder().raw_decode(line)
    except (ValueError, RecursionError):
        return True
    return False
