"""`ear pretrained`."""

from __future__ import annotations

import json
from dataclasses import dataclass

from ear_jax import pretrained
from ear_jax.cli.arguments import parse
from ear_jax.cli.results import print_table


@dataclass(frozen=True)
class PretrainedCommand:
    """List the trained agents that ship with the package, with their training, their return and the tasks they meet.

    Example: ear pretrained --json
    """

    json: bool = False
    """Print one JSON document and nothing else."""


def main(words: list[str]) -> None:
    command = parse(PretrainedCommand, words, "pretrained")
    cards = [pretrained.card(name) for name in pretrained.names()]
    if command.json:
        print(json.dumps({"pretrained": cards}))
        return
    rows = []
    for card in cards:
        trained = f"{card['minutes']:.0f} min, {card['updates']:,} updates"
        outcomes = [task["met"] for task in card["tasks"] if "met" in task]
        met = f"{sum(outcomes)} of {len(outcomes)}" if outcomes else "–"
        among = f"{card['seeds']} ({card['mean_of_seeds']:.1f})" if "seeds" in card else "–"
        rows.append((card["name"], card["agent"], trained, f"{card['mean_return']:.1f}", among, met))
    print_table(("name", "agent", "trained", "return>", "of seeds (mean)>", "tasks met>"), rows)
    print("A task is met if no episode ends early and the error is less than half the distance to the next task.")
    print("Tasks without a target are not counted. --json prints every task, and the rest of each agent's card.")
    print("`ear demo --pretrained NAME` shows an agent at work; commands that play a policy take pretrained:NAME.")
