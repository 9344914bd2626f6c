"""`ear pretrained`."""

from __future__ import annotations

import json
from dataclasses import dataclass

from rich.console import Console
from rich.table import Table

from ear_jax import pretrained
from ear_jax.cli.arguments import parse


@dataclass(frozen=True)
class PretrainedCommand:
    """List the trained agents that ship with the package: how they were trained, what they reach and what they miss."""

    json: bool = False
    """Print one JSON document and nothing else."""


def main(words: list[str]) -> None:
    command = parse(PretrainedCommand, words, "pretrained")
    cards = [pretrained.card(name) for name in pretrained.names()]
    if command.json:
        print(json.dumps({"pretrained": cards}))
        return
    table = Table()
    for heading in ("name", "agent", "trained", "return", "tasks met"):
        table.add_column(heading, justify="right" if heading in ("return", "tasks met") else "left", overflow="fold")
    for card in cards:
        trained = f"{card['minutes']:.0f} min, {card['updates']:,} updates"
        judged = [task["met"] for task in card["tasks"] if "met" in task]
        met = f"{sum(judged)} of {len(judged)}" if judged else "–"
        table.add_row(card["name"], card["agent"], trained, f"{card['mean_return']:.1f}", met)
    Console(highlight=False).print(table)
    print("A task is met where every episode lasts and what it achieves is less than half way to the next task off.")
    print("One that commands no target is not counted. --json tells of each task, and all else of the cards.")
    print("`ear demo --pretrained NAME` shows one at work; pretrained:NAME stands wherever a command takes a run.")
