"""A section for each of the paper's tables and figures, and one for the runs behind them."""

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
from experiments.report import blends, composition, pictures, settings, spaces, tables
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
    "table-10": composition.composition,
    "agents": tables.agents,
    "wide": partial(tables.variants, "wide"),
    "gathered": partial(tables.variants, "gathered"),
    "categorical": partial(tables.variants, "categorical"),
    "equivariant": partial(tables.variants, "equivariant"),
    "refined": tables.refined,
    "space": spaces.spaces,
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

# What a policy does between tasks, where that is on its sphere, how it was learnt, new tasks, and composition.
FIRST = ("figure-3", "figure-7", "figure-2", "figure-5", "figure-4")


def section(experiment: Experiment, index: RunIndex, out: Path) -> Section:
    """Builds the section of one table or figure; draws its pictures into `out`/figures."""
    if experiment.id in TABLES:
        blocks = TABLES[experiment.id](index)
    else:
        blocks = FIGURES[experiment.id](experiment.id, index, out) or [f"{lack(index.behind(experiment))}."]
    if not experiment.methods:
        return Section(experiment.id, title(experiment), blocks)
    how_to = f"Reproduce it with `python -m experiments reproduce {experiment.id} --preset {index.preset}`."
    blocks = [how_to, *blocks, _runs_behind(experiment, index)]
    return Section(experiment.id, title(experiment), blocks, _lack(experiment, index))


def title(experiment: Experiment) -> str:
    return f"{experiment.id.replace('-', ' ').capitalize()}: {experiment.shows}"


def _lack(experiment: Experiment, index: RunIndex) -> str:
    """Returns the reason our results are missing, or an empty string."""
    runs = [(run, method.analyses) for method in experiment.methods for run in index.of(method)]
    shown = any(not analyses or any(run.document(analysis.name) for analysis in analyses) for run, analyses in runs)
    return "" if shown else lack(runs).removeprefix(f"{MISSING}, ")


def _runs_behind(experiment: Experiment, index: RunIndex) -> Table:
    """Returns a table of the commands behind an experiment: each run and analysis, and methods without a run."""
    rows = []
    for method in experiment.methods:
        runs = index.of(method)
        for run in runs:
            rows.append([run.name, run.command, *facts(run)])
            rows += [[f"{run.name}: {one.name}", *_provenance(run.document(one.name))] for one in method.analyses]
        if not runs:
            name = f"{NAMES[method.family]}, {label(method)}"
            rows.append([name, NO_RUN, *[MISSING] * 5])
    rows = [[name, f"`{command}`" if command.startswith("ear ") else command, *rest] for name, command, *rest in rows]
    columns = ("run", "command", "env steps", "updates", "minutes", "commit", "machine")
    return Table("Runs and analyses behind this.", columns, rows, folded=True)


def _provenance(document: dict[str, Any] | None) -> list[str]:
    """Returns the command, commit and machine of an analysis."""
    if document is None:
        return ["not analysed yet", *[MISSING] * 5]
    where = document.get("machine", {}).get("processor", MISSING)
    command = document.get("command", "command not recorded")
    return [command, *[MISSING] * 3, document.get("commit") or MISSING, where]


def facts(run: Run) -> list[str]:
    """Returns budget, commit and machine of a run."""
    last = run.last
    spent = [count(last["env_steps"]), count(last["updates"]), number(run.minutes)]
    return [*spent, run.about["commit"] or MISSING, machine(run)]


def machine(run: Run) -> str:
    """Describes the machine of a run and the number of seeds beside it."""
    return describe_machine(run.about["machine"], run.config.seeds)


def describe_machine(where: dict[str, Any], seeds: int) -> str:
    """Describes a machine as records have it, and the number of seeds it trained side by side."""
    processor = f"{where['processor']}, {where['cores']} core{'s'[: where['cores'] > 1]}"
    return where.get("accelerator", processor) + (f", {seeds} seeds side by side" if seeds > 1 else "")


def all_runs(index: RunIndex) -> Section:
    """Builds the section of all runs: epochs done, budget, machine, and settings that have changed since."""
    rows = [
        [
            run.name,
            f"seed {run.seed}",
            f"{count(run.last['epoch'])} of {count(run.config.epochs)}",
            *facts(run),
            ", ".join(f"{name} {value}" for name, value in run.changes.items()) or "none",
        ]
        for run in index.all()
    ]
    columns = ("run", "seed", "epochs", "env steps", "updates", "minutes", "commit", "machine", "settings that differ")
    caption = (
        f"Recorded runs of `{index.preset}`: epochs done out of those planned, and settings that differ from today's "
        "preset."
    )
    blocks: list[Block] = [Table(caption, columns, rows)] if rows else [f"{NO_RUN}."]
    return Section("runs", "Runs", blocks)


def first_figures(index: RunIndex, out: Path) -> list[Section]:
    """Builds the figures that a reader wants first."""
    return [section(EXPERIMENTS[id], index, out) for id in FIRST]


def other_sections(index: RunIndex, out: Path) -> list[Section]:
    """Builds all other tables and figures, in the paper's order, and ours after them."""
    return [section(experiment, index, out) for id, experiment in EXPERIMENTS.items() if id not in FIRST]
