"""Two groups of runs compared: settings that differ, returns with intervals, probability of improvement. No JAX."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ear_jax.errors import RunError, UsageError
from ear_jax.runs import records
from ear_jax.runs.groups import Group, RunRecords
from ear_jax.runs.statistics import bootstrap_interval, interquartile_mean, probability_of_improvement

Returns = list[dict[str, float]]  # of every seed, by task

EVALUATIONS = "evaluation.json"
LAST_ROWS = "the last row of metrics.jsonl"


@dataclass(frozen=True)
class Evaluated:
    """Returns of the last policies of a run."""

    returns: Returns
    episodes: int  # of each task


def compare(one: Group, other: Group) -> dict[str, Any]:
    """Compares two groups by their returns on the tasks that both have.

    Returns are those of `ear evaluate` if all runs have such a document for their last policy, and otherwise those of
    the last row of metrics. Intervals are 95 % percentile intervals of a bootstrap over seeds, stratified by task, as
    in rliable; they need two seeds.

    Returns:
      The document that `ear compare --json` prints.

    Raises:
      UsageError: no task is common.
      RunError: an evaluation cannot be read.
    """
    evaluated = [[_evaluated(run) for run in members.runs] for members in (one, other)]
    complete = all(run is not None for runs in evaluated for run in runs)
    if not complete:
        evaluated = [[_last_rows(run) for run in members.runs] for members in (one, other)]
    both = [[seed for run in runs if run for seed in run.returns] for runs in evaluated]
    episodes = [_distinct([run.episodes for run in runs if run]) for runs in evaluated]
    tasks = [task for task in both[0][0] if all(task in seed for returns in both for seed in returns)]
    if not tasks:
        raise UsageError(f"{one.name} and {other.name} have no task in common")
    ours, theirs = (np.array([[seed[task] for task in tasks] for seed in returns]) for returns in both)
    enough = min(len(ours), len(theirs)) > 1
    return {
        "settings": differences(one, other),
        "returns_from": EVALUATIONS if complete else LAST_ROWS,
        "tasks": tasks,
        "groups": [_describe(*group) for group in zip((one, other), (ours, theirs), episodes, strict=True)],
        "probability_of_improvement": {
            "value": float(probability_of_improvement(ours, theirs)),
            "interval": bootstrap_interval(probability_of_improvement, ours, theirs) if enough else None,
        },
    }


def differences(one: Group, other: Group) -> list[dict[str, Any]]:
    """Lists the settings in which two groups differ, each with the values in one and the other; seeds are left out."""
    ours, theirs = ([run.settings for run in members.runs] for members in (one, other))
    found = []
    for name in {name: None for settings in (*ours, *theirs) for name in settings}:
        values = [_distinct([settings.get(name) for settings in group]) for group in (ours, theirs)]
        if name not in ("seed", "seeds") and values[0] != values[1]:
            found.append({"name": name, "values": values})
    return found


def mean(scores: np.ndarray) -> np.ndarray:
    """Returns the mean [...] over seeds and tasks of scores [..., seeds, tasks]."""
    return np.asarray(np.mean(scores, axis=(-2, -1)))


def _describe(members: Group, scores: np.ndarray, episodes: Any) -> dict[str, Any]:
    several = len(scores) > 1
    last = [rows[-1] for rows in members.seeds]
    return {
        "name": members.name,
        "runs": [str(run.path) for run in members.runs],
        "seeds": len(scores),
        **{
            name: {
                "value": float(statistic(scores)),
                "interval": bootstrap_interval(statistic, scores) if several else None,
            }
            for name, statistic in (("mean", mean), ("interquartile_mean", interquartile_mean))
        },
        "episodes": episodes,
        "env_steps": _distinct([row["env_steps"] for row in last]),
        "updates": _distinct([row["updates"] for row in last]),
        "minutes": _distinct([round(row["seconds"] / 60, 1) for row in last]),
        "returns": scores.tolist(),  # [seeds, tasks]
    }


def _distinct(values: list[Any]) -> Any:
    """Returns the only value of a list, or its distinct values in their order."""
    distinct = [value for index, value in enumerate(values) if value not in values[:index]]
    return distinct[0] if len(distinct) == 1 else distinct


def _last_rows(run: RunRecords) -> Evaluated:
    return Evaluated([rows[-1]["returns"] for rows in run.seeds.values()], run.settings["log.episodes"])


def _evaluated(run: RunRecords) -> Evaluated | None:
    """Returns a run's evaluation, if there is one of its last policies."""
    path = run.path / EVALUATIONS
    if not path.is_file():
        return None
    document = records.read_json(path)
    try:
        seeds = {one["seed"]: {task["name"]: task["return_mean"] for task in one["tasks"]} for one in document["seeds"]}
        current = all(rows[-1]["updates"] == document["updates"] for rows in run.seeds.values())
        episodes = document["episodes"]
    except (KeyError, TypeError) as error:
        raise RunError(f"{path} cannot be read: {error}") from None
    if not current or seeds.keys() != run.seeds.keys():
        return None
    return Evaluated([seeds[seed] for seed in run.seeds], episodes)
