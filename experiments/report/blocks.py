"""The parts of a report before they are rendered as HTML or Markdown. Backticks in a text mark code."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Table:
    """A table of text; the first column names the rows."""

    caption: str
    columns: tuple[str, ...]
    rows: list[list[str]]
    folded: bool = False  # collapsed in HTML until it is opened


@dataclass(frozen=True)
class Picture:
    """A figure in a file of its own."""

    file: str  # relative to the page
    caption: str


@dataclass(frozen=True)
class Points:
    """A list with one bullet for each sentence."""

    lines: list[str]


Block = str | Table | Picture | Points  # a string is a paragraph


@dataclass(frozen=True)
class Section:
    """A heading with its link target and the blocks below it."""

    id: str
    title: str
    blocks: list[Block]
    lack: str = ""  # why our results are missing, if they are
