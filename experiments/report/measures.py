"""Numbers taken from runs and their analyses, and from the paper's tables."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ear_jax.embeddings.interpolate import MID_TASK_RANGE, REACHED
from ear_jax.envs import FAMILIES
from ear_jax.runs import safetensors
from experiments.inventory import POLICY
from experiments.paper import ANT, CHEETAH, HOPPER, WALKER, numbers
from experiments.report.formatting import MISSING, NAMES, seeds, spread
from experiments.report.run_index import Run

BLENDED = (CHEETAH, HOPPER, WALKER, ANT)  # in the order of tables 11 to 18


def task_returns(run: Run) -> dict[str, float]:
    """Mean return of each training task: of the run's evaluation, or of the last one during training."""
    for one in run.of_seed("evaluation", "seeds"):
        return {task["name"]: task["return_mean"] for task in one["tasks"]}
    return run.last["returns"]


class Count(NamedTuple):
    """How many of how many, over the seeds that tell."""

    number: int
    total: int
    seeds: tuple[int, ...]

    def __str__(self) -> str:
        return f"{self.number} of {self.total}"


def mean_return(run: Run) -> float:
    """The mean over training tasks: what the paper's table 1 compares."""
    return float(np.mean(list(task_returns(run).values())))


def returns(runs: Sequence[Run]) -> str:
    """Their mean return and its spread over seeds, in words."""
    return f"{spread([mean_return(run) for run in runs])} ({seeds(runs)})" if runs else MISSING


def score_table(runs: Sequence[Run]) -> np.ndarray:
    """Returns [seeds, tasks]."""
    return np.array([list(task_returns(run).values()) for run in runs])


def successes(runs: Sequence[Run], what: str) -> Count | None:
    """How many pairs of neighbours succeed at `mid_task` or `one_to_one`; None where no run has them."""
    return _counted({run.seed: [pair[what] for pair in run.of_seed("interpolation", "pairs")] for run in runs})


def failed_tasks(runs: Sequence[Run]) -> Count | None:
    """How many tasks had an episode that ended early; None where no run was evaluated so."""

    def failed(run: Run) -> list[bool]:
        tasks = [task for one in run.of_seed("evaluation", "seeds") for task in one["tasks"]]
        return [task["failures"] > 0 for task in tasks if "failures" in task]

    return _counted({run.seed: failed(run) for run in runs})


def goal_distances(run: Run) -> list[float]:
    """Of each goal of Metaworld-Reach, how far from it the fingertips were over the second half, in metres: of their
    mean place; empty without an evaluation."""
    goals = {task["name"]: task["params"] for task in run.made["tasks"]}
    return [
        math.dist(*([place[axis] for axis in "xyz"] for place in (goals[task["name"]], task["outcome"])))
        for one in run.of_seed("evaluation", "seeds")
        for task in one["tasks"]
    ]


def gaps(run: Run) -> np.ndarray:
    """Angles between the LTEs of each two tasks that are blended as neighbours, in degrees; none where a run lacks its
    policy or its pairs."""
    path, pairs = run.place / POLICY, run.of_seed("interpolation", "pairs")
    if not path.is_file() or not pairs:
        return np.zeros(0)
    arrays, _ = safetensors.read(path)
    place = {task["name"]: index for index, task in enumerate(run.made["tasks"])}
    codes = arrays["codes"][run.seed - run.config.seed]
    ends = np.array([[place[name] for name in pair["between"]] for pair in pairs]).T
    return np.degrees(np.arccos(np.clip(np.sum(codes[ends[0]] * codes[ends[1]], axis=-1), -1, 1)))


def _counted(of_seeds: dict[int, list[bool]]) -> Count | None:
    told = {seed: one for seed, one in of_seeds.items() if one}
    return Count(sum(map(sum, told.values())), sum(map(len, told.values())), tuple(told)) if told else None


def difference(family: str, one: Any, other: Any) -> Any:
    """one − other; of directions the short way round, in degrees."""
    apart = np.asarray(one, float) - np.asarray(other, float)
    period = FAMILIES[family].period
    return apart if period is None else (apart + period / 2) % period - period / 2


def unit(family: str) -> str:
    return FAMILIES[family].unit.replace("degrees", "°")


def paper_return(family: str, agent: str) -> dict[str, float] | None:
    """Mean and standard deviation of a method in table 1; None where the paper has none."""
    table = numbers()["table-1"]
    if family not in table["columns"]:
        return None
    rows = {row[0]: row for row in table["panels"][""]}
    row = rows.get(NAMES[agent])
    return row[table["columns"].index(family)] if row else None


def paper_counts(family: str, what: str) -> dict[str, int] | None:
    """Success of interpolation in table 5, `mid_task` or `one_to_one`; None where the paper has none."""
    table = numbers()["table-5"]
    if family not in table["columns"]:
        return None
    row = table["panels"][""][("mid_task", "one_to_one").index(what)]
    return row[table["columns"].index(family)]


def paper_recount(family: str, what: str) -> Count:
    """The same by `ear interpolate`'s rule, from the targets and outcomes of each seed in tables 11 to 18."""
    table = {"mid_task": 11, "one_to_one": 15}[what] + BLENDED.index(family)
    counted = {}
    for seed, rows in enumerate(numbers()[f"table-{table}"]["panels"].values()):
        target, outcome, gap = np.array([row[0] for row in rows]), [row[-1] for row in rows], rows[1][0] - rows[0][0]
        miss = np.abs(difference(family, outcome, target))
        if what == "one_to_one":
            counted[seed] = list(miss < gap / 2)
        else:
            inside = [MID_TASK_RANGE[0] < row[1] < MID_TASK_RANGE[1] for row in rows]
            near = miss <= REACHED * gap + 1e-6  # the paper's two digits, as floats
            counted[seed] = list(near & np.array(inside))
    found = _counted(counted)
    assert found
    return found


def paper_setting(table: str, row: str, family: str) -> Any:
    """A row of the paper's tables of settings, 2 or 3, for a family."""
    data = numbers()[table]
    place = next(place for place, column in enumerate(data["columns"]) if family in column.split(" and "))
    return next(line[place] for line in data["panels"][""] if line[0] == row)


def paper_budget(family: str) -> tuple[int, int]:
    """Environment steps and updates of the paper's EAR-SAC, from its tables 2 and 3."""
    tasks = int(paper_setting("table-3", "EAR-SAC", family).split()[0])
    steps, pretrain, epochs, updates = (
        paper_setting("table-2", row, family)
        for row in ("max episode frames", "pretrain epochs", "training epochs", "optimization times")
    )
    return tasks * steps * (pretrain + epochs), epochs * updates
