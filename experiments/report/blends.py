"""The paper's tables of single blends of two tasks beside ours, one column for each seed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np

from ear_jax.runs.statistics import interquartile_mean
from experiments.paper import BOTH, CHEETAH, COMPOSED, FRONT, MET, RUN_JUMP, SLOWER, WALK_STAND, Analysis, numbers
from experiments.report.blocks import Block, Table
from experiments.report.formatting import MISSING, NAMES, VARIANTS, interval, lack, number, percent, printed, spread
from experiments.report.measures import difference, unit
from experiments.report.run_index import Run, RunIndex

RUNNING = 1.0  # m/s backward, from which on a blend runs
Column = Mapping[Any, str]  # a seed's cells by the key of their row


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
    """Returns tables 11 to 14: the β that best meets the value midway, and its outcome."""
    panels = numbers()[table]["panels"]
    paper = {name: {target: _arrow(beta, outcome) for target, beta, outcome in rows} for name, rows in panels.items()}
    pairs = _pairs(index, family)
    ours = {
        f"seed {seed}": {target: _arrow(pair["beta"], pair["outcome"]) for target, pair in by_target.items()}
        for seed, by_target in pairs.items()
    }
    outcomes = {seed: {target: pair["outcome"] for target, pair in row.items()} for seed, row in pairs.items()}
    caption = (
        f"{NAMES[family]}: target ({unit(family)}), and for each seed the suitable β → the outcome ({unit(family)})."
    )
    targets = [row[0] for row in next(iter(panels.values()))]
    theirs = [[row[2] for row in rows] for rows in panels.values()]
    return [
        side_by_side(caption, "target", targets, paper, ours, index.runs(family)),
        _miss(family, targets, theirs, outcomes),
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
        _miss(family, targets, theirs, outcomes),
    ]


def _pairs(index: RunIndex, family: str) -> dict[int, dict[float, dict[str, Any]]]:
    """Returns each seed's pairs of neighbouring tasks by the value midway between them."""
    runs = {run.seed: run.of_seed("interpolation", "pairs") for run in index.runs(family)}
    return {seed: {round(pair["target"], 2): pair for pair in pairs} for seed, pairs in runs.items() if pairs}


def _arrow(beta: float, outcome: float) -> str:
    return f"{number(beta, 2)} → {number(outcome, 2)}"


def _mean_outcome(family: str, target: float, outcomes: dict[int, dict[float, float]]) -> str:
    """Returns mean and spread over seeds. Directions are averaged as distances from the target: 359° and 1° give 0°."""
    values = [target + difference(family, row[target], target) for row in outcomes.values() if target in row]
    return spread(values, 2) if values else MISSING


def _miss(family: str, targets: list[float], theirs: list[list[float]], ours: dict[int, dict[float, float]]) -> str:
    """Returns a sentence on the distance of outcomes from the values midway, the paper's and ours."""
    complete = [
        [row[target] for target in targets] for row in ours.values() if all(target in row for target in targets)
    ]

    def summary(outcomes: list[list[float]]) -> str:
        miss = np.abs(difference(family, np.array(outcomes), np.array(targets)))
        if len(miss) < 2:
            return f"{number(float(interquartile_mean(miss)), 3)} {unit(family)} (1 seed)"
        return f"{interval(interquartile_mean, miss, digits=3)} {unit(family)} ({len(miss)} seeds)"

    distance = summary(complete) if complete else MISSING
    measure = "Distance from the value midway, interquartile mean with its 95 % interval"
    return f"{measure}: paper {summary(theirs)}; ours {distance}."


def met(index: RunIndex) -> list[Block]:
    """Returns table 4: speeds met between 2 and 3 m/s. β = 1 and 0 are the two tasks themselves, as evaluated."""
    panels = numbers()["table-4"]["panels"]
    paper = {name: {row[0]: _arrow(row[1], row[2]) for row in rows} for name, rows in panels.items()}
    ours = {f"seed {run.seed}": column for run in index.runs(CHEETAH) if (column := _met_by(run))}
    caption = "HalfCheetah-Vel: commanded speed from 2 to 3 m/s, and for each seed the β → the speed (m/s)."
    return [
        side_by_side(caption, "task", [row[0] for row in next(iter(panels.values()))], paper, ours, index.runs(CHEETAH))
    ]


def _met_by(run: Run) -> dict[str, str]:
    blends = [pair for analysis in MET for pair in run.of_seed(analysis.name, "pairs")]
    column = {f"vel-{pair['target']:g}": _arrow(pair["beta"], pair["outcome"]) for pair in blends}
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
        paper = {"": {beta: number(outcome, 2) for beta, outcome in rows}}
        first, second = panel.split(" & ")
        caption = (
            f"{NAMES[family]}, {first} (β = 1) and {second} (β = 0): outcome ({unit(family)}) at β outside [0, 1]."
        )
        blocks.append(side_by_side(caption, "β", [row[0] for row in rows], paper, ours, index.runs(family)))
    return blocks


def composition(index: RunIndex) -> list[Block]:
    """Returns table 10: the β that the paper chose by eye, and the outcomes of our blends along β."""
    panels = numbers()["table-10"]["panels"]
    chosen = [[name, *(printed(cell) for cell in row)] for name, rows in panels.items() for row in rows]
    blocks: list[Block] = [
        Table("The β that the paper chose by eye for each composition.", ("seed", "composition", "β"), chosen)
    ]
    runs = {variant: index.runs(RUN_JUMP, variant=variant) for variant in ("", BOTH)}
    for variant, several in runs.items():
        for run, analysis in product(several, (*COMPOSED, SLOWER)):
            for composed in run.of_seed(analysis.name, "seeds"):
                seed = f"seed {run.seed}{VARIANTS[variant]}"
                blocks.append(_along_beta(seed, run.document(analysis.name) or {}, composed["blends"]))
                blocks += [] if analysis == WALK_STAND else [_doing_both(composed["blends"])]
    if len(blocks) == 1:
        blocks.append(f"Ours: {lack(runs[''])}.")
    return [*blocks, *_both_at_once(runs)]


def _both_at_once(runs: Mapping[str, list[Run]]) -> Iterator[Block]:
    """Tells how many LTEs all over the sphere run with the hind foot raised, and how high at best.

    Args:
      runs: by variant.
    """
    for variant, run in ((variant, run) for variant, several in runs.items() for run in several):
        for traded in run.of_seed(FRONT.name, "seeds"):
            ends = [task["rewards"][1] for task in traded["trained"] if task["name"] in ("back-7", "jump-10")]
            mean = sum(ends) / 2
            heights = [height for speed, height in traded["rewards"] if speed > RUNNING]
            raised = sum(height > mean for height in heights)
            yield (
                f"Seed {run.seed}{VARIANTS[variant]}: of {len(traded['rewards']):,} LTEs, {len(heights):,} run "
                f"backward faster than {RUNNING:g} m/s. Of these, {raised or 'none'} hold the hind foot higher than "
                f"{number(mean, 2)} m, the mean of run and jump; at best it is at "
                f"{number(max(heights, default=0.0), 2)} m."
            )


def _doing_both(blends: list[dict[str, Any]]) -> str:
    """Tells which blends between two tasks run with the hind foot higher than the mean of the two."""
    outcomes = {blend["beta"]: (-blend["outcome"]["velocity"], blend["outcome"]["height"]) for blend in blends}
    mean = (outcomes[1][1] + outcomes[0][1]) / 2
    wanted = f"faster than {RUNNING:g} m/s with the hind foot higher than {number(mean, 2)} m, the mean of the two ends"
    between = {beta: outcome for beta, outcome in outcomes.items() if 0 < beta < 1}
    found = {beta: at for beta, at in between.items() if at[0] > RUNNING and at[1] > mean}
    if not found:
        return f"No blend between them runs backward {wanted}."
    each = ", ".join(f"β = {beta:g} ({number(at[0], 2)} m/s at {number(at[1], 2)} m)" for beta, at in found.items())
    return f"Backward {wanted}: {each}. The end at β = 0 runs at {number(outcomes[0][0], 2)} m/s by itself."


def _along_beta(seed: str, document: dict[str, Any], blends: list[dict[str, Any]]) -> Table:
    first, second = document["between"]
    feet = document["feet"]
    rows = [
        [
            printed(blend["beta"]),
            number(blend["outcome"]["velocity"], 2),
            number(blend["outcome"]["height"], 2),
            *(percent(blend["contact"][foot], 0) for foot in feet),
            percent(blend["airborne"], 0),
        ]
        for blend in blends
    ]
    ends = f"{first} (β = 1) to {second} (β = 0)"
    caption = f"Ours, {seed}: {ends}, {document['steps']} steps; means over the second half."
    down = tuple(f"{foot} foot down" for foot in feet)
    return Table(caption, ("β", "velocity (m/s)", "height (m)", *down, "no foot down"), rows)
