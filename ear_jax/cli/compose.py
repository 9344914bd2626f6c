"""`ear compose RUN`."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

from rich.console import Console
from rich.table import Table

from ear_jax.cli.arguments import check_finite, check_least, parse
from ear_jax.cli.interpolate import find_end
from ear_jax.cli.on_run import OnRun
from ear_jax.embeddings.compose import BETAS, compose
from ear_jax.errors import UsageError
from ear_jax.figures.compose import draw_gaits
from ear_jax.process.terminal import phase
from ear_jax.runs import records


@dataclass(frozen=True, kw_only=True)
class ComposeCommand(OnRun):
    """Do two tasks of different kinds at once: a grid of blends of their LTEs, f(β Z₁ + (1 − β) Z₂)."""

    between: tuple[str, str]
    """Two tasks it was trained on, as in walk stand, or LTEs saved by `ear adapt --save`."""
    beta: tuple[float, ...] = BETAS
    """The blends: 1 is the first, 0 the second."""
    steps: int = 1000
    """Environment steps of each."""


def main(words: list[str]) -> None:
    command = parse(ComposeCommand, words, "compose")
    check_least(command, steps=2)
    if not command.beta:
        raise UsageError("--beta needs numbers, as in 1 0.5 0")
    check_finite("--beta", *command.beta)
    trained = command.load()
    first, second = (find_end(trained, word) for word in command.between)
    if first.name == second.name:
        raise UsageError(f"--between {' '.join(command.between)} names one task twice")
    with phase(f"rolling out {len(command.beta)} blends"):
        document = compose(trained, first, second, command.beta, command.steps, command.seed)
    records.write_json(trained.directory / "composition.json", {**document, **records.provenance()})
    pictures = draw_gaits(trained.directory / "figures", document)
    if command.json:
        print(json.dumps({**document, "figures": [str(path) for path in pictures]}))
        return
    _print(document)
    print("pictures: " + ", ".join(str(path) for path in pictures))


def _print(document: dict[str, Any]) -> None:
    names = list(document["seeds"][0]["blends"][0]["outcome"])
    table = Table(title=f"{document['between'][0]} (β = 1) to {document['between'][1]} (β = 0)", title_justify="left")
    for heading in ("seed", "β", *names, *(f"{foot} foot down" for foot in document["feet"]), "steps"):
        table.add_column(heading, justify="right")
    for one in document["seeds"]:
        for blend in one["blends"]:
            outcomes = (f"{blend['outcome'][name]:.2f}" for name in names)
            feet = (f"{blend['contact'][foot]:.0%}" for foot in document["feet"])
            fell = f"{blend['length']}, fell" if blend["fell"] else str(blend["length"])
            table.add_row(str(one["seed"]), f"{blend['beta']:g}", *outcomes, *feet, fell)
    Console(highlight=False).print(table)
