"""The card of an agent that ships: how it was trained, what it reaches and what it does not, computed from a record."""

from __future__ import annotations

from typing import Any

from ear_jax.envs import Family
from ear_jax.errors import RunError
from ear_jax.runs.trained import Trained

CURVE_POINTS = 20
UNKNOWN = "It has not been evaluated: which tasks it meets is not known."


def make_card(
    name: str, trained: Trained, command: str, rows: list[dict[str, Any]], evaluation: dict[str, Any] | None
) -> dict[str, Any]:
    """What a person should know of an agent, but for its file's size and checksum.

    Args:
      name: what it is called.
      trained: its policy, of one seed.
      command: the `ear train` that trained it, and the seeds beside it.
      rows: the run's metrics, of all its seeds.
      evaluation: what `ear evaluate --json` printed of them, if anything.

    Raises:
      RunError: the metrics have no row of the policy's epoch.
    """
    config, about, family = trained.program.config, trained.about, trained.program.family
    rows = [row for row in rows if row["seed"] == config.seed and row["epoch"] <= trained.epoch]
    if not rows or rows[-1]["epoch"] != trained.epoch:
        raise RunError(f"{trained.name} is of epoch {trained.epoch}, and metrics.jsonl beside it has no row of that")
    last = rows[-1]
    if evaluation:
        found = next(one for one in evaluation["seeds"] if one["seed"] == config.seed)
        episodes, source = evaluation["episodes"], "evaluation.json"
        mean_return, tasks = found["mean_return"], [judge(family, task, found["tasks"]) for task in found["tasks"]]
    else:
        mean_return, episodes, source = last["mean_return"], config.log.episodes, "metrics.jsonl, last row"
        tasks = [{"name": task, "return": value} for task, value in last["returns"].items()]
    return {
        "name": name,
        "family": config.family,
        "agent": config.agent,
        "preset": config.preset,
        "command": command,
        "seed": config.seed,
        "side_by_side": about.get("side_by_side", 1),  # seeds that were trained in those minutes
        "env_steps": last["env_steps"],
        "updates": last["updates"],
        "minutes": round(last["seconds"] / 60, 1),
        "mean_return": mean_return,
        "returns_from": source,
        "episodes": episodes,  # a task
        "limits": limits(tasks, episodes, family.unit) if evaluation else UNKNOWN,
        "tasks": tasks,
        "learning_curve": thinned(rows),
        **{key: about[key] for key in ("engine", "machine", "versions", "commit")},
    }


def judge(family: Family, task: dict[str, Any], all_tasks: list[dict[str, Any]]) -> dict[str, Any]:
    """A task of an evaluation, and if it commands something, whether it is met.

    It is where every episode lasts and what is achieved is nearer to its target than half way to the next task's.
    """
    kept = {"name": task["name"], "target": task["target"], "return": task["return_mean"], "failures": task["failures"]}
    if task["target"] is None:
        return {**kept, "outcome": task["outcome"]}
    achieved = task["outcome"][family.commanded]
    others = [one["target"] for one in all_tasks if one["target"] not in (None, task["target"])]
    gap = min((abs(family.difference(other, task["target"])) for other in others), default=float("inf"))
    error = abs(family.difference(achieved, task["target"]))
    return {**kept, "achieved": achieved, "error": error, "met": error < gap / 2 and not task["failures"]}


def limits(tasks: list[dict[str, Any]], episodes: int, unit: str) -> str:
    """Which tasks an agent does not meet, and what it does without a target; `episodes` a task were played."""
    judged = [task for task in tasks if "met" in task]
    missed = [task for task in judged if not task["met"]]
    off = ", ".join(f"{task['achieved']:.2f} for {task['name']}" for task in missed if not task["failures"])
    ended = [task for task in tasks if task["failures"]]
    over = ", ".join(f"{task['name']} ({task['failures']} of {episodes} episodes)" for task in ended)
    free = ", ".join(f"{task['name']} ({_means(task['outcome'])})" for task in tasks if "met" not in task)
    parts = [
        f"meets {len(judged) - len(missed)} of {len(judged)} tasks" if judged else "",
        f"achieves ({unit}) {off}" if off else "",
        f"ends early in {over}" if over else "",
        f"on tasks without a target has {free}" if free else "",
    ]
    told = "; ".join(filter(None, parts))
    return f"{told[0].upper()}{told[1:]}."


def _means(outcome: dict[str, float]) -> str:
    return ", ".join(f"{name} {value:.2f}" for name, value in outcome.items())


def thinned(rows: list[dict[str, Any]]) -> list[dict[str, float]]:
    """At most `CURVE_POINTS` rows of the metrics, evenly spaced up to the last."""
    every = -(-len(rows) // CURVE_POINTS)
    return [
        {
            "minutes": round(row["seconds"] / 60, 2),
            "env_steps": row["env_steps"],
            "updates": row["updates"],
            "mean_return": round(row["mean_return"], 2),
        }
        for row in rows[::-every][::-1]
    ]
