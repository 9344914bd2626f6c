"""`ear interpolate RUN`."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from rich.console import Console
from rich.table import Table

from ear_jax.cli.arguments import check_finite, check_least, parse
from ear_jax.cli.on_run import OnRun
from ear_jax.embeddings import ltes
from ear_jax.embeddings.interpolate import End, Pair, adjacent_pairs, interpolate, play_blends, trained_ends
from ear_jax.envs import find_task
from ear_jax.errors import UsageError
from ear_jax.figures.interpolate import draw_blends
from ear_jax.process.terminal import phase
from ear_jax.runs import records
from ear_jax.runs.trained import Trained

HEADINGS = {"mid_task": "mid", "one_to_one": "1:1", "one_to_one_outcome": "at β = ½"}


@dataclass(frozen=True, kw_only=True)
class InterpolateCommand(OnRun):
    """Do what lies between two trained tasks, or beyond them, with no training: f(β Z₁ + (1 − β) Z₂)."""

    between: tuple[str, str] | None = None
    """Two tasks it was trained on, as in 2 3, or LTEs saved by `ear adapt --save`."""
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


def main(words: list[str]) -> None:
    command = parse(InterpolateCommand, words, "interpolate")
    if command.all_pairs == (command.between is not None):
        raise UsageError("say either --between A B or --all-pairs")
    if command.target is not None and (command.beta or command.all_pairs):
        raise UsageError("--target goes with --between A B alone")
    check_finite("--beta", *command.beta)
    if command.target is not None:
        check_finite("--target", command.target)
    check_least(command, episodes=1)
    trained = command.load()
    family = trained.program.family
    neighbours = adjacent_pairs(trained_ends(trained), family)
    pairs = [find_pair(trained, *command.between)] if command.between else neighbours
    with phase("rolling out"):
        if command.beta:
            document = _at_betas(trained, pairs, command)
        else:
            arguments = (command.target, command.episodes, command.seed, command.along)
            document = interpolate(trained, pairs, *arguments)
    records.write_json(trained.directory / "interpolation.json", {**document, **records.provenance()})
    pictures = draw_blends(trained.directory / "figures", document)
    if command.json:
        print(json.dumps({**document, "figures": [str(path) for path in pictures]}))
        return
    _print(document, family.unit)
    print("pictures: " + ", ".join(str(path) for path in pictures))


def find_pair(trained: Trained, first: str, second: str) -> Pair:
    """The ends of an interpolation, each commanding something, from what a person calls them.

    Raises:
      UsageError: something not trained on or saved, that commands nothing, or twice the same.
    """
    ends = find_end(trained, first), find_end(trained, second)
    for end in ends:
        if end.target is None:
            raise UsageError(f"{end.name!r} commands no {trained.program.family.commanded}; see `ear compose`")
    if ends[0].name == ends[1].name:
        raise UsageError(f"--between {first} {second} names one task twice")
    return ends


def find_end(trained: Trained, word: str) -> End:
    """A saved LTE by its name, or a training task."""
    family, program = trained.program.family, trained.program
    if word in ltes.saved(trained.directory):
        saved = ltes.lookup(trained.directory, word, trained.fingerprint)
        return End(word, find_task(family, saved["task"]).target, np.array(saved["codes"], np.float32))
    return trained_ends(trained)[program.tasks.index(find_task(family, word).name)]


def _at_betas(trained: Trained, pairs: list[Pair], command: InterpolateCommand) -> dict[str, Any]:
    achieved = play_blends(trained, pairs, command.beta, command.episodes, command.seed, command.along)
    return {
        "blends": [
            {
                "seed": trained.program.config.seed + index,
                "between": [one.name, other.name],
                "beta": beta,
                "outcome": float(value),
            }
            for index, rows in enumerate(achieved)
            for (one, other), row in zip(pairs, rows, strict=True)
            for beta, value in zip(command.beta, row, strict=True)
        ],
        "commanded": trained.program.family.quantity,
    }


def _print(document: dict[str, Any], unit: str) -> None:
    table = Table()
    rows = document.get("pairs") or document["blends"]
    columns = [key for key in rows[0] if key not in ("between", "curve")]
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
