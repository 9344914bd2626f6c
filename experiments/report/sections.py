"""A section for each of the paper's tables and figures, and one for the runs they are made of."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from experiments.paper import (
    ANT,
    CHEETAH,
    DIRECTIONS_BEYOND,
    EXPERIMENTS,
    SPEEDS_BEYOND,
    Experiment,
)
from experiments.report import blends, pictures, settings, tables
from experiments.report.blocks import Block, Section, Table
from experiments.report.formatting import MISSING, NAMES, NO_RUN, count, label, lack, number
from experiments.report.measures import BLENDED
from experiments.report.run_index import Run, RunIndex

BEYOND = {CHEETAH: SPEEDS_BEYOND, ANT: DIRECTIONS_BEYOND}
TABLES: dict[str, Callable[[RunIndex], list[Block]]] = {
    "table-1": tables.all_returns,
    "table-2": settings.hyperparameters,
    "table-3": settings.training_tasks,
    "table-4": blends.met,
    "table-5": tables.interpolation_counts,
    "table-6": partial(blends.beyond, BEYOND),
    "table-7": tables.episode_ends,
    "table-8": tables.failures,
    "table-9": tables.normalisation,
    "table-10": blends.composition,
    "agents": tables.agents,
    "wide": partial(tables.variants, "wide"),
    "gathered": partial(tables.variants, "gathered"),
    "reach": tables.reach,
    **{f"table-{11 + index}": partial(blends.midway, f"table-{11 + index}", one) for index, one in enumerate(BLENDED)},
    **{f"table-{15 + index}": partial(blends.halfway, f"table-{15 + index}", one) for index, one in enumerate(BLENDED)},
}
FIGURES: dict[str, Callable[[str, RunIndex, Path], list[Block]]] = {
    **{f"figure-{number}": pictures.training for number in (2, 8, 10, 12, 13)},
    **{f"figure-{number}": pictures.adaptation for number in (5, 11, 14)},
    "figure-3": pictures.stills,
    "figure-4": pictures.composed,
    "figure-6": pictures.sensory,
    "figure-7": pictures.sphere,
    "figure-9": pictures.each_task,
}


def section(experiment: Experiment, found: RunIndex, out: Path) -> Section:
    """What there is of one table or figure; draws its pictures into `out`/figures."""
    if experiment.id in TABLES:
        blocks = TABLES[experiment.id](found)
    else:
        blocks = FIGURES[experiment.id](experiment.id, found, out) or [f"{lack(found.behind(experiment))}."]
    if not experiment.methods:
        return Section(experiment.id, title(experiment), blocks)
    made = f"`python -m experiments reproduce {experiment.id} --preset {found.preset}` makes it."
    blocks = [made, *blocks, _runs_behind(experiment, found)]
    return Section(experiment.id, title(experiment), blocks, _lack(experiment, found))


def title(experiment: Experiment) -> str:
    return f"{experiment.id.replace('-', ' ').capitalize()}: {experiment.shows}"


def _lack(experiment: Experiment, found: RunIndex) -> str:
    """Why there is nothing of ours to show, or an empty string."""
    runs = [(run, method.analyses) for method in experiment.methods for run in found.of(method)]
    shown = any(not analyses or any(run.document(one.name) for one in analyses) for run, analyses in runs)
    return "" if shown else lack(runs).removeprefix(f"{MISSING}, ")


def _runs_behind(experiment: Experiment, found: RunIndex) -> Table:
    """The commands behind an experiment, a row a run and analysis, and methods that have no run."""
    rows = []
    for method in experiment.methods:
        runs = found.of(method)
        for run in runs:
            rows.append([run.name, run.command, *facts(run)])
            rows += [[f"{run.name}: {one.name}", *_made(run.document(one.name))] for one in method.analyses]
        if not runs:
            name = f"{NAMES[method.family]}, {label(method)}"
            rows.append([name, NO_RUN, *[MISSING] * 5])
    rows = [[name, f"`{command}`" if command.startswith("ear ") else command, *rest] for name, command, *rest in rows]
    columns = ("run", "command", "env steps", "updates", "minutes", "commit", "machine")
    return Table("Runs and analyses behind it.", columns, rows, folded=True)


def _made(document: dict[str, Any] | None) -> list[str]:
    """By what an analysis was made, and from what commit and where."""
    if document is None:
        return ["not made yet", *[MISSING] * 5]
    where = document.get("machine", {}).get("processor", MISSING)
    command = document.get("command", "command not recorded")
    return [command, *[MISSING] * 3, document.get("commit") or MISSING, where]


def facts(run: Run) -> list[str]:
    """Budget, commit and machine of a run."""
    last = run.last
    spent = [count(last["env_steps"]), count(last["updates"]), number(run.minutes)]
    return [*spent, run.made["commit"] or MISSING, machine(run)]


def machine(run: Run) -> str:
    """What trained a run, and beside how many."""
    return describe_machine(run.made["machine"], run.config.seeds)


def describe_machine(where: dict[str, Any], seeds: int) -> str:
    """A machine as records have it, and how many seeds it trained side by side."""
    processor = f"{where['processor']}, {where['cores']} core{'s'[: where['cores'] > 1]}"
    return where.get("accelerator", processor) + (f", {seeds} seeds side by side" if seeds > 1 else "")


def all_runs(found: RunIndex) -> Section:
    """Every run of the preset, with how far it went and what its settings were then."""
    rows = [
        [
            run.name,
            f"seed {run.seed}",
            f"{count(run.last['epoch'])} of {count(run.config.epochs)}",
            *facts(run),
            ", ".join(f"{name} {value}" for name, value in run.changes.items()) or "none",
        ]
        for run in found.all()
    ]
    columns = ("run", "seed", "epochs", "env steps", "updates", "minutes", "commit", "machine", "other settings then")
    caption = (
        f"Recorded runs of `{found.preset}`: epochs done of those they were begun with, and settings that the preset "
        "has otherwise today."
    )
    blocks: list[Block] = [Table(caption, columns, rows)] if rows else [f"{NO_RUN}."]
    return Section("runs", "Runs", blocks)


def all_sections(found: RunIndex, out: Path) -> list[Section]:
    return [section(experiment, found, out) for experiment in EXPERIMENTS.values()]
