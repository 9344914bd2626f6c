"""What a report is made of, before it is a page or Markdown. In every text `words` between backticks are code."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Table:
    """Cells as text; the first column names the rows."""

    caption: str
    columns: tuple[str, ...]
    rows: list[list[str]]
    folded: bool = False  # shown on demand


@dataclass(frozen=True)
class Picture:
    """A figure beside the page."""

    file: str  # relative to the page
    caption: str


@dataclass(frozen=True)
class Points:
    """Sentences, one a bullet."""

    lines: list[str]


Block = str | Table | Picture | Points  # text alone is a paragraph


@dataclass(frozen=True)
class Section:
    """A heading, what it is linked by, and what stands below it."""

    id: str
    title: str
    blocks: list[Block]
    lack: str = ""  # why there is nothing of ours
