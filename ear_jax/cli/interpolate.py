"""`ear interpolate RUN`."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import tyro
from rich.console import Console
from rich.table import Table

from ear_jax import records
from ear_jax.cli.arguments import parse
from ear_jax.errors import UsageError
from ear_jax.interpolate import adjacent_pairs, interpolate, play_blends
from ear_jax.runtime import enable_cache
from ear_jax.terminal import phase
from ear_jax.trained import Trained, load

HEADINGS = {"mid_task": "mid", "one_to_one": "1:1", "one_to_one_outcome": "at β = ½"}


@dataclass(frozen=True)
class InterpolateCommand:
    """Do what lies between two trained tasks, or beyond them, with no training: f(β Z₁ + (1 − β) Z₂)."""

    run: tyro.conf.Positional[Path]
    """The run directory."""
    between: tuple[str, str] | None = None
    """The two tasks, as in 2 3."""
    all_pairs: bool = False
    """Every two neighbouring tasks, midway."""
    target: float | None = None
    """What to meet between them; midway if not given."""
    beta: tuple[float, ...] = ()
    """Instead of meeting a target, say what these β achieve; outside [0, 1] they extrapolate."""
    along: Literal["chord", "arc"] = "chord"
    """The paper's normalised sum, or the great circle."""
    episodes: int = 3
    """Episodes a blend."""
    seed: int = 0
    """Seeds the starts."""
    json: bool = False
    """Print one JSON document and nothing else."""


def main(words: list[str]) -> None:
    command = parse(InterpolateCommand, words, "interpolate")
    if command.all_pairs == (command.between is not None):
        raise UsageError("say either --between A B or --all-pairs")
    if command.target is not None and (command.beta or command.all_pairs):
        raise UsageError("--target goes with --between A B alone")
    if command.episodes < 1:
        raise UsageError(f"--episodes {command.episodes} is too small; it must be at least 1")
    enable_cache()
    trained = load(command.run)
    pairs = adjacent_pairs(trained.program) if command.all_pairs else [_pair(trained, *(command.between or ()))]
    with phase("rolling out"):
        if command.beta:
            document = _at_betas(trained, pairs, command)
        else:
            arguments = (command.target, command.episodes, command.seed, command.along)
            document = interpolate(trained, pairs, *arguments)
    records.write_json(command.run / "interpolation.json", {**document, **records.provenance()})
    if command.json:
        print(json.dumps(document))
    else:
        _print(document, trained.program.family.unit)


def _pair(trained: Trained, first: str, second: str) -> tuple[int, int]:
    """Rows of two tasks that were trained on and command something."""
    family, tasks = trained.program.family, trained.program.tasks
    rows = tuple(tasks.index(family.parse_task(name).name) for name in (first, second))
    for row in rows:
        if tasks.tasks[row].target is None:
            raise UsageError(f"task {tasks.names[row]!r} commands no {family.commanded}; see `ear compose`")
    if rows[0] == rows[1]:
        raise UsageError(f"--between {first} {second} names one task twice")
    return rows[0], rows[1]


def _at_betas(trained: Trained, pairs: list[tuple[int, int]], command: InterpolateCommand) -> dict[str, Any]:
    achieved = play_blends(trained, pairs, command.beta, command.episodes, command.seed, command.along)
    names, first_seed = trained.program.tasks.names, trained.program.config.seed
    return {
        "blends": [
            {"seed": first_seed + index, "between": [names[one], names[other]], "beta": beta, "outcome": float(value)}
            for index, rows in enumerate(achieved)
            for (one, other), row in zip(pairs, rows, strict=True)
            for beta, value in zip(command.beta, row, strict=True)
        ]
    }


def _print(document: dict[str, Any], unit: str) -> None:
    table = Table()
    rows = document.get("pairs") or document["blends"]
    columns = [key for key in rows[0] if key != "between"]
    for heading in ("between", *columns):
        table.add_column(HEADINGS.get(heading, heading))
    for row in rows:
        table.add_row("–".join(row["between"]), *(_show(row[key]) for key in columns))
    console = Console(highlight=False)
    console.print(table)
    console.print(f"outcomes in {unit}")
    for what in ("mid_task", "one_to_one"):
        if what in document:
            console.print(f"{what.replace('_', ' ')}: {document[what]['success']} of {document[what]['total']}")


def _show(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.2f}" if isinstance(value, float) else str(value)
