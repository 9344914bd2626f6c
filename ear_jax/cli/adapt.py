"""`ear adapt RUN`."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro
from rich.console import Console
from rich.table import Table

from ear_jax import records
from ear_jax.adapt import Search, adapt
from ear_jax.cli.arguments import parse
from ear_jax.errors import UsageError
from ear_jax.runtime import enable_cache
from ear_jax.tasks import task_set
from ear_jax.terminal import phase
from ear_jax.trained import load


@dataclass(frozen=True)
class AdaptCommand:
    """Search the codes of tasks the policy was never trained on, by the cross-entropy method."""

    run: tyro.conf.Positional[Path]
    """The run directory."""
    target: tuple[str, ...] = ()
    """The tasks, as in 3.6; by default the family's adaptation tasks."""
    epochs: int = 10
    """Epochs of the search."""
    elites: int = 6
    """Codes kept from one epoch to the next."""
    samples: int = 14
    """Neighbours of each that are tried."""
    sigma: float = 0.5
    """How far away, a standard deviation a coordinate."""
    episodes: int = 5
    """Fresh episodes by which an epoch's best is judged again."""
    seed: int = 0
    """Seeds the search, and the family's adaptation tasks."""
    json: bool = False
    """Print one JSON document and nothing else."""


def main(words: list[str]) -> None:
    command = parse(AdaptCommand, words, "adapt")
    for name in ("epochs", "elites", "episodes"):
        if getattr(command, name) < 1:
            raise UsageError(f"--{name} {getattr(command, name)} is too small; it must be at least 1")
    if command.samples < 0 or not command.sigma > 0:
        raise UsageError("--samples must be at least 0 and --sigma above 0")
    enable_cache()
    trained = load(command.run)
    family = trained.program.family
    named = [family.parse_task(text) for text in command.target]
    tasks = task_set(named) if named else family.adaptation_tasks(command.seed)
    if not len(tasks):
        raise UsageError(f"{family.name} has no adaptation tasks of its own; name some with --target")
    search = Search(command.epochs, command.elites, command.samples, command.sigma)
    with phase(f"searching {len(tasks)} × {search.epochs} × {search.candidates} episodes"):
        document = adapt(trained, tasks, search, command.episodes, command.seed)
    records.write_json(command.run / "adaptation.json", {**document, **records.provenance()})
    if command.json:
        print(json.dumps(document))
    else:
        _print(document)


def _print(document: dict[str, Any]) -> None:
    table = Table(title=f"{document['env_steps']:,} env steps in {document['seconds']:.0f} s", title_justify="left")
    for heading in ("task", "seed", "best: 1st", "3rd", "last epoch", "judged again", "LTE"):
        table.add_column(heading)
    for task in document["tasks"]:
        epochs = task["epochs"]
        best = [f"{epochs[min(epoch, len(epochs) - 1)]['best_of_epoch']:.1f}" for epoch in (0, 2, len(epochs) - 1)]
        code = " ".join(f"{number:.2f}" for number in task["lte"])
        table.add_row(task["name"], str(task["seed"]), *best, f"{epochs[-1]['reevaluated']:.1f}", code)
    Console(highlight=False).print(table)
