"""Sections as one HTML page without scripts or network access."""

from __future__ import annotations

import html
import re
from collections.abc import Sequence

from experiments.report.blocks import Block, Picture, Points, Section, Table

CSS = """
:root { color-scheme: light; --line: #d5d9de; --soft: #f5f6f8; --ink: #1c2330; --dim: #5a6472; --link: #0b5c9e; }
* { box-sizing: border-box; }
body { margin: 0; font: 16px/1.55 system-ui, sans-serif; color: var(--ink); background: white; }
.page { max-width: 72rem; margin: 0 auto; padding: 1.5rem 1.25rem 4rem; }
h1 { font-size: 1.7rem; line-height: 1.25; margin: 0 0 1rem; }
h2 { font-size: 1.25rem; line-height: 1.3; margin: 3rem 0 .6rem; }
h2 { padding-top: .8rem; border-top: 1px solid var(--line); }
p, ul { max-width: 46rem; margin: .6rem 0; }
a { color: var(--link); }
code { font: .88em ui-monospace, monospace; background: var(--soft); padding: .08em .3em; border-radius: 3px; }
nav { background: var(--soft); padding: .8rem 1.1rem; border-radius: 6px; }
nav ul { columns: 21rem; column-gap: 2rem; max-width: none; padding: 0; margin: .4rem 0; list-style: none; }
nav li { break-inside: avoid; padding: .12rem 0; }
.lack { color: var(--dim); font-size: .9em; white-space: nowrap; }
.box { overflow-x: auto; margin: .4rem 0 1.2rem; border: 1px solid var(--line); border-radius: 6px; }
.box { background: linear-gradient(90deg, white 30%, #fff0) local, linear-gradient(270deg, white 30%, #fff0) 100% local,
  linear-gradient(90deg, #0003, #0000), linear-gradient(270deg, #0003, #0000) 100%; }
.box { background-size: 2.5rem 100%, 2.5rem 100%, .7rem 100%, .7rem 100%; background-repeat: no-repeat; }
.box:focus-visible { outline: 2px solid var(--link); }
table { border-collapse: collapse; width: 100%; font-size: .875rem; font-variant-numeric: tabular-nums; }
th, td { padding: .38rem .7rem; text-align: left; vertical-align: top; border-bottom: 1px solid var(--line); }
td { white-space: nowrap; }
td code { white-space: nowrap; }
thead th { background: var(--soft); font-weight: 600; vertical-align: bottom; }
tbody tr:last-child > * { border-bottom: 0; }
tbody th { font-weight: 500; min-width: 9.5rem; }
.caption { margin: 1.2rem 0 .2rem; font-size: .92rem; }
figure { margin: 1.2rem 0; }
.scroll { overflow-x: auto; }
.scroll img { max-width: 100%; min-width: 44rem; height: auto; }
figcaption { max-width: 46rem; font-size: .92rem; color: var(--dim); }
details { margin: .6rem 0; }
summary { cursor: pointer; color: var(--link); }
"""


def page(title: str, lead: Sequence[Block], sections: Sequence[Section]) -> str:
    """Renders the whole report; `lead` precedes the table of contents."""
    parts = [
        f"<h1>{text(title)}</h1>",
        *map(block, lead),
        contents(sections),
        *(
            f'<section id="{section.id}">\n<h2>{text(section.title)}</h2>\n'
            + "\n".join(map(block, section.blocks))
            + "\n</section>"
            for section in sections
        ),
    ]
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{text(title)}</title>\n<style>{CSS}</style>\n</head>\n"
        '<body>\n<main class="page">\n' + "\n".join(parts) + "\n</main>\n</body>\n</html>\n"
    )


def contents(sections: Sequence[Section]) -> str:
    """Renders the table of contents; sections whose results are missing are marked."""
    entries = "\n".join(
        f'<li><a href="#{section.id}">{text(section.title)}</a>'
        + (f' <span class="lack">{text(section.lack)}</span>' if section.lack else "")
        + "</li>"
        for section in sections
    )
    return f'<nav aria-label="Contents">\n<strong>Contents</strong>\n<ul>\n{entries}\n</ul>\n</nav>'


def block(one: Block) -> str:
    if isinstance(one, Table):
        return table(one)
    if isinstance(one, Points):
        return "<ul>\n" + "\n".join(f"<li>{text(line)}</li>" for line in one.lines) + "\n</ul>"
    if isinstance(one, Picture):
        image = f'<img src="{html.escape(one.file)}" alt="{html.escape(one.caption)}">'
        box = f'<div class="scroll" tabindex="0">{image}</div>'
        return f"<figure>\n{box}\n<figcaption>{text(one.caption)}</figcaption>\n</figure>"
    return f"<p>{text(one)}</p>"


def table(one: Table) -> str:
    """Renders a table that scrolls inside its box if it is wider than the screen."""
    head = "".join(f'<th scope="col">{text(column)}</th>' for column in one.columns)
    rows = "\n".join(
        f'<tr><th scope="row">{text(first)}</th>' + "".join(f"<td>{text(cell)}</td>" for cell in rest) + "</tr>"
        for first, *rest in one.rows
    )
    label = html.escape(one.caption)
    box = (
        f'<div class="box" tabindex="0" role="region" aria-label="{label}">\n<table>\n'
        f"<thead><tr>{head}</tr></thead>\n<tbody>\n{rows}\n</tbody>\n</table>\n</div>"
    )
    if one.folded:
        return f"<details>\n<summary>{text(one.caption)}</summary>\n{box}\n</details>"
    return f'<p class="caption">{text(one.caption)}</p>\n{box}'


def text(words: str) -> str:
    """Escapes a text, turns backticks into code, and keeps a % on the line of its number."""
    return re.sub(r"`([^`]+)`", r"<code>\1</code>", html.escape(words)).replace(" %", "&nbsp;%")
