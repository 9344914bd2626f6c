"""Sections as Markdown."""

from __future__ import annotations

from collections.abc import Sequence

from experiments.report.blocks import Block, Picture, Points, Section, Table


def document(title: str, lead: Sequence[Block], sections: Sequence[Section]) -> str:
    """Renders the whole report as one file."""
    parts = [f"# {title}", *map(block, lead)]
    for section in sections:
        parts += [f"## {section.title}", *map(block, section.blocks)]
    return "\n\n".join(parts) + "\n"


def block(one: Block) -> str:
    """Renders a block; a picture is a link to its file."""
    if isinstance(one, Table):
        return f"{text(one.caption)}\n\n{table(one)}"
    if isinstance(one, Points):
        return "\n".join(f"- {text(line)}" for line in one.lines)
    if isinstance(one, Picture):
        return f"![{text(one.caption)}]({one.file})\n\n{text(one.caption)}"
    return text(one)


def table(one: Table) -> str:
    """Renders a table without its caption."""
    rule = ["---"] * len(one.columns)
    return "\n".join("| " + " | ".join(map(text, row)) + " |" for row in (one.columns, rule, *one.rows))


def text(words: str) -> str:
    """Escapes a text, so that nothing in it is read as HTML or as the end of a cell."""
    return words.replace("&", "&amp;").replace("<", "&lt;").replace("|", "\\|").replace("\n", " ")
