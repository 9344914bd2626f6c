"""Measures of runs and their analyses, and the paper's values of the same."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ear_jax.embeddings.interpolate import REACHED
from ear_jax.envs import FAMILIES
from ear_jax.runs import safetensors
from ear_jax.runs.statistics import probability_of_improvement
from experiments.inventory import POLICY
from experiments.paper import ANT, CHEETAH, HOPPER, REFINEMENT, WALKER, numbers
from experiments.report.formatting import MISSING, NAMES, count, interval, seeds, spread
from experiments.report.run_index import Run

BLENDED = (CHEETAH, HOPPER, WALKER, ANT)  # in the order of tables 11 to 18
FIRST = 5  # episodes of a task among which one that ends early counts, as in the paper


def task_returns(run: Run) -> dict[str, float]:
    """Returns the mean return of each training task: from `ear evaluate`, or else from the last row of training."""
    for evaluation in run.of_seed("evaluation", "seeds"):
        return {task["name"]: task["return_mean"] for task in evaluation["tasks"]}
    return run.last["returns"]


class Count(NamedTuple):
    """A share as two integers, with the seeds it was counted over."""

    number: int
    total: int
    seeds: tuple[int, ...]

    def __str__(self) -> str:
        return f"{self.number} of {self.total}"


def mean_return(run: Run) -> float:
    """Returns the mean return over training tasks, as the paper's table 1 compares it."""
    return float(np.mean(list(task_returns(run).values())))


def returns(runs: Sequence[Run]) -> str:
    """Formats the mean return of runs, its spread and their number of seeds."""
    return f"{spread([mean_return(run) for run in runs])} ({seeds(runs)})" if runs else MISSING


def refinements(runs: Sequence[Run]) -> list[dict[str, Any]]:
    """Returns what `ear refine` did to each of the runs that it was used on."""
    return [entry for run in runs for entry in run.of_seed(REFINEMENT.name, "seeds")]


def refined_returns(runs: Sequence[Run]) -> str:
    """Formats the mean return of refined policies; if only some runs were refined, also theirs before, and how many."""
    found = refinements(runs)
    if not found:
        return MISSING
    before, after = ([entry[when] for entry in found] for when in ("before", "after"))
    if len(found) == len(runs):
        return spread(after)
    return f"{spread(before)} → {spread(after)} ({count(len(found))} of {count(len(runs))})"


def shared_tasks(runs: Sequence[Run]) -> list[str]:
    """Returns the names of the tasks that all runs have; PEARL and MAML have more than the others."""
    return [name for name in task_returns(runs[0]) if all(name in task_returns(run) for run in runs[1:])]


def score_table(runs: Sequence[Run], tasks: Sequence[str]) -> np.ndarray:
    """Gives the returns [seeds, tasks] of runs on tasks that all of them have."""
    return np.array([[task_returns(run)[name] for name in tasks] for run in runs])


def chance_of_more(ours: Sequence[Run], theirs: Sequence[Run]) -> str | None:
    """Formats the probability that a seed of ours returns more on the same task; None if they share no task."""
    tasks = shared_tasks([*ours, *theirs]) if ours and theirs else []
    if not tasks:
        return None
    return interval(probability_of_improvement, score_table(ours, tasks), score_table(theirs, tasks), digits=2)


def successes(runs: Sequence[Run], measure: str, document: str = "interpolation") -> Count | None:
    """Counts the pairs of neighbours that succeed at `fresh`, `mid_task` or `one_to_one`; None if no run has it."""

    def succeeded(run: Run) -> list[bool]:
        return [pair[measure] for pair in run.of_seed(document, "pairs") if measure in pair]

    return _counted({run.seed: succeeded(run) for run in runs})


def fresh_error(family: str, runs: Sequence[Run]) -> float | None:
    """Returns the mean distance from the value midway in fresh episodes of the blend found; None if no run has it."""
    pairs = [pair for run in runs for pair in run.of_seed("interpolation", "pairs") if "fresh_outcome" in pair]
    misses = [abs(difference(family, pair["fresh_outcome"], pair["target"])) for pair in pairs]
    return float(np.mean(misses)) if misses else None


def failed_tasks(runs: Sequence[Run]) -> Count | None:
    """Counts the tasks of whose first five episodes one ended early; None if no run was evaluated."""

    def failed(run: Run) -> list[bool]:
        length = FAMILIES[run.config.family].episode_length
        tasks = [task for evaluation in run.of_seed("evaluation", "seeds") for task in evaluation["tasks"]]
        return [min(task["episodes"]["length"][:FIRST]) < length for task in tasks if "failures" in task]

    return _counted({run.seed: failed(run) for run in runs})


def goal_distances(run: Run) -> list[float]:
    """Returns the distance in metres from each goal of Metaworld-Reach to the fingertips' mean position over the second
    half of the episodes; empty without an evaluation."""
    goals = {task["name"]: task["params"] for task in run.about["tasks"]}
    return [
        math.dist(*([point[axis] for axis in "xyz"] for point in (goals[task["name"]], task["outcome"])))
        for evaluation in run.of_seed("evaluation", "seeds")
        for task in evaluation["tasks"]
    ]


def gaps(run: Run) -> np.ndarray:
    """Returns the angles in degrees between the LTEs of neighbouring tasks [pairs]; empty if a run lacks its policy or
    its interpolation."""
    path, pairs = run.directory / POLICY, run.of_seed("interpolation", "pairs")
    if not path.is_file() or not pairs:
        return np.zeros(0)
    arrays, _ = safetensors.read(path)
    rows = {task["name"]: index for index, task in enumerate(run.about["tasks"])}
    codes = arrays["codes"][run.seed - run.config.seed]
    ends = np.array([[rows[name] for name in pair["between"]] for pair in pairs]).T
    return np.degrees(np.arccos(np.clip(np.sum(codes[ends[0]] * codes[ends[1]], axis=-1), -1, 1)))


def _counted(of_seeds: dict[int, list[bool]]) -> Count | None:
    counted = {seed: outcomes for seed, outcomes in of_seeds.items() if outcomes}
    if not counted:
        return None
    return Count(sum(map(sum, counted.values())), sum(map(len, counted.values())), tuple(counted))


def difference(family: str, one: Any, other: Any) -> Any:
    """Returns one − other; for directions the shorter way round, in degrees."""
    apart = np.asarray(one, float) - np.asarray(other, float)
    period = FAMILIES[family].period
    return apart if period is None else (apart + period / 2) % period - period / 2


def unit(family: str) -> str:
    return FAMILIES[family].unit.replace("degrees", "°")


def paper_return(family: str, agent: str) -> dict[str, float] | None:
    """Returns mean and standard deviation of a method in table 1; None if the paper has none."""
    table = numbers()["table-1"]
    if family not in table["columns"]:
        return None
    rows = {row[0]: row for row in table["panels"][""]}
    row = rows.get(NAMES[agent])
    return row[table["columns"].index(family)] if row else None


def paper_counts(family: str, measure: str) -> dict[str, int] | None:
    """Returns success of interpolation in table 5, `mid_task` or `one_to_one`; None if the paper has none."""
    table, told = numbers()["table-5"], ("mid_task", "one_to_one")
    if family not in table["columns"] or measure not in told:
        return None
    row = table["panels"][""][told.index(measure)]
    return row[table["columns"].index(family)]


def paper_recount(family: str, measure: str) -> Count | None:
    """Counts the same from the one blend that tables 11 to 18 list for a pair."""
    table = {"mid_task": 11, "one_to_one": 15}[measure] + BLENDED.index(family)
    panels = numbers()[f"table-{table}"]["panels"].values()
    return _counted({seed: _meets(family, measure, rows) for seed, rows in enumerate(panels)})


def recount(family: str, runs: Sequence[Run], measure: str) -> Count | None:
    """Counts ours as `paper_recount` does, from the one blend that our tables 11 to 18 list for a pair."""
    told = {"mid_task": ("target", "outcome"), "one_to_one": ("target", "one_to_one_outcome")}[measure]
    listed = {run.seed: sorted([pair[name] for name in told] for pair in _pairs(run)) for run in runs if _pairs(run)}
    return _counted({seed: _meets(family, measure, rows) for seed, rows in listed.items()})


def _pairs(run: Run) -> list[dict[str, Any]]:
    return run.of_seed("interpolation", "pairs")


def _meets(family: str, measure: str, rows: Sequence[Sequence[float]]) -> list[bool]:
    """Tells for each pair whether the blend listed for it succeeds, whatever its β.

    Args:
      family: the family's name.
      measure: `mid_task` or `one_to_one`.
      rows: of every pair of evenly spaced neighbours, the value midway first and the outcome last.
    """
    miss = np.abs(difference(family, [row[-1] for row in rows], [row[0] for row in rows]))
    gap = rows[1][0] - rows[0][0]
    near = miss < gap / 2 if measure == "one_to_one" else miss <= REACHED * gap + 1e-6  # decimals are inexact as floats
    return list(near)


def paper_setting(table: str, row: str, family: str) -> Any:
    """Returns a setting of a family from the paper's table 2 or 3."""
    data = numbers()[table]
    index = next(index for index, column in enumerate(data["columns"]) if family in column.split(" and "))
    return next(line[index] for line in data["panels"][""] if line[0] == row)


def paper_budget(family: str) -> tuple[int, int]:
    """Returns env steps and updates of the paper's EAR-SAC, from its tables 2 and 3."""
    tasks = int(paper_setting("table-3", "EAR-SAC", family).split()[0])
    steps, pretrain, epochs, updates = (
        paper_setting("table-2", row, family)
        for row in ("max episode frames", "pretrain epochs", "training epochs", "optimization times")
    )
    return tasks * steps * (pretrain + epochs), epochs * updates
