"""The paper's tables of single blends of two tasks beside ours, one column for each seed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ear_jax.embeddings.interpolate import FRESH
from ear_jax.runs.statistics import interquartile_mean
from experiments.paper import CHEETAH, MET, Analysis, numbers
from experiments.report.blocks import Block, Table
from experiments.report.formatting import MISSING, NAMES, interval, lack, number, printed, spread
from experiments.report.measures import difference, unit
from experiments.report.run_index import Run, RunIndex

AGAIN = f"In brackets: the same β in the mean of {FRESH} fresh episodes."
Column = Mapping[Any, str]  # a seed's cells by the key of their row
Outcomes = dict[int, dict[float, float]]  # by seed and target


def side_by_side(
    caption: str,
    key: str,
    keys: Sequence[Any],
    paper: Mapping[str, Column],
    ours: Mapping[str, Column],
    runs: Sequence[Run],
) -> Table:
    """Returns a table with a row for each key: the paper's columns, then ours, or one column saying why not."""
    columns = {f"paper, {name}" if name else "paper": column for name, column in paper.items()}
    columns |= {f"ours, {name}": column for name, column in ours.items()} or {"ours": {keys[0]: lack(runs)}}
    rows = [[printed(row), *(column.get(row, MISSING) for column in columns.values())] for row in keys]
    return Table(caption, (key, *columns), rows)


def midway(table: str, family: str, index: RunIndex) -> list[Block]:
    """Returns tables 11 to 14: the β that comes nearest to the value midway, and its outcomes."""
    panels = numbers()[table]["panels"]
    paper = {name: {target: _arrow(beta, outcome) for target, beta, outcome in rows} for name, rows in panels.items()}
    pairs = _pairs(index, family)
    ours = {
        f"seed {seed}": {target: _met(pair) for target, pair in by_target.items()} for seed, by_target in pairs.items()
    }
    found, again = (
        {seed: {target: pair[what] for target, pair in row.items() if what in pair} for seed, row in pairs.items()}
        for what in ("outcome", "fresh_outcome")
    )
    caption = (
        f"{NAMES[family]}: target ({unit(family)}), and for each seed the β that came nearest → the outcome "
        f"({unit(family)}). {AGAIN}"
    )
    targets = [row[0] for row in next(iter(panels.values()))]
    theirs = [[row[2] for row in rows] for rows in panels.values()]
    return [
        side_by_side(caption, "target", targets, paper, ours, index.runs(family)),
        _miss(family, targets, theirs, found, again),
    ]


def halfway(table: str, family: str, index: RunIndex) -> list[Block]:
    """Returns tables 15 to 18: the outcome at β = ½."""
    panels = numbers()[table]["panels"]
    paper = {name: {target: number(outcome, 2) for target, outcome in rows} for name, rows in panels.items()}
    outcomes = {
        seed: {target: pair["one_to_one_outcome"] for target, pair in row.items()}
        for seed, row in _pairs(index, family).items()
    }
    ours = {f"seed {seed}": {key: number(value, 2) for key, value in row.items()} for seed, row in outcomes.items()}
    targets = [row[0] for row in next(iter(panels.values()))]
    if len(outcomes) > 1:
        ours["mean ± std"] = {target: _mean_outcome(family, target, outcomes) for target in targets}
    caption = f"{NAMES[family]}: midway between two tasks ({unit(family)}), and for each seed the outcome at β = ½."
    theirs = [[row[1] for row in rows] for rows in panels.values()]
    return [
        side_by_side(caption, "midway", targets, paper, ours, index.runs(family)),
        _miss(family, targets, theirs, outcomes, {}),
    ]


def _pairs(index: RunIndex, family: str) -> dict[int, dict[float, dict[str, Any]]]:
    """Returns each seed's pairs of neighbouring tasks by the value midway between them."""
    runs = {run.seed: run.of_seed("interpolation", "pairs") for run in index.runs(family)}
    return {seed: {round(pair["target"], 2): pair for pair in pairs} for seed, pairs in runs.items() if pairs}


def _arrow(beta: float, outcome: float) -> str:
    return f"{number(beta, 2)} → {number(outcome, 2)}"


def _met(pair: Mapping[str, Any]) -> str:
    """Formats the β found between two tasks with its outcome, and that in fresh episodes where there are any."""
    again = f" ({number(pair['fresh_outcome'], 2)})" if "fresh_outcome" in pair else ""
    return _arrow(pair["beta"], pair["outcome"]) + again


def _mean_outcome(family: str, target: float, outcomes: dict[int, dict[float, float]]) -> str:
    """Returns mean and spread over seeds. Directions are averaged as distances from the target: 359° and 1° give 0°."""
    values = [target + difference(family, row[target], target) for row in outcomes.values() if target in row]
    return spread(values, 2) if values else MISSING


def _miss(family: str, targets: list[float], theirs: list[list[float]], ours: Outcomes, again: Outcomes) -> str:
    """Returns a sentence on the distance of outcomes from the values midway: the paper's, ours, ours played again."""

    def complete(outcomes: Outcomes) -> list[list[float]]:
        return [
            [row[target] for target in targets] for row in outcomes.values() if all(target in row for target in targets)
        ]

    def summary(outcomes: list[list[float]]) -> str:
        miss = np.abs(difference(family, np.array(outcomes), np.array(targets)))
        if len(miss) < 2:
            return f"{number(float(interquartile_mean(miss)), 3)} {unit(family)} (1 seed)"
        return f"{interval(interquartile_mean, miss, digits=3)} {unit(family)} ({len(miss)} seeds)"

    played, fresh = complete(ours), complete(again)
    distance = summary(played) if played else MISSING
    distance += f", in fresh episodes {summary(fresh)}" if fresh else ""
    measure = "Distance from the value midway, interquartile mean with its 95 % interval"
    return f"{measure}: paper {summary(theirs)}; ours {distance}."


def met(index: RunIndex) -> list[Block]:
    """Returns table 4: speeds met between 2 and 3 m/s. β = 1 and 0 are the two tasks themselves, as evaluated."""
    panels = numbers()["table-4"]["panels"]
    paper = {name: {row[0]: _arrow(row[1], row[2]) for row in rows} for name, rows in panels.items()}
    ours = {f"seed {run.seed}": column for run in index.runs(CHEETAH) if (column := _met_by(run))}
    caption = f"HalfCheetah-Vel: commanded speed from 2 to 3 m/s, and for each seed the β → the speed (m/s). {AGAIN}"
    return [
        side_by_side(caption, "task", [row[0] for row in next(iter(panels.values()))], paper, ours, index.runs(CHEETAH))
    ]


def _met_by(run: Run) -> dict[str, str]:
    blends = [pair for analysis in MET for pair in run.of_seed(analysis.name, "pairs")]
    column = {f"vel-{pair['target']:g}": _met(pair) for pair in blends}
    for evaluation in run.of_seed("evaluation", "seeds"):
        trained = {task["name"]: task["outcome"]["velocity"] for task in evaluation["tasks"]}
        column |= {name: _arrow(beta, trained[name]) for name, beta in (("vel-2", 1), ("vel-3", 0)) if name in trained}
    return column


def beyond(analyses: Mapping[str, Sequence[Analysis]], index: RunIndex) -> list[Block]:
    """Returns table 6: outcomes at β outside [0, 1].

    Args:
      analyses: the extrapolations of each family, in the order of the paper's panels.
      index: the runs.
    """
    pairs = [(family, analysis) for family, several in analyses.items() for analysis in several]
    blocks: list[Block] = []
    for (family, analysis), (panel, rows) in zip(pairs, numbers()["table-6"]["panels"].items(), strict=True):
        ours = {}
        for run in index.runs(family):
            blends = run.of_seed(analysis.name, "blends")
            if blends:
                ours[f"seed {run.seed}"] = {blend["beta"]: number(blend["outcome"], 2) for blend in blends}
        paper = {"seed 3": {beta: number(outcome, 2) for beta, outcome in rows}}  # as its caption says
        first, second = panel.split(" & ")
        caption = (
            f"{NAMES[family]}, {first} (β = 1) and {second} (β = 0): outcome ({unit(family)}) at β outside [0, 1]."
        )
        blocks.append(side_by_side(caption, "β", [row[0] for row in rows], paper, ours, index.runs(family)))
    return blocks
