"""The card of a policy: its training, its results and its limits, computed from its records."""

from __future__ import annotations

import shlex
from typing import Any

from ear_jax.config import Config, flat
from ear_jax.envs import Family
from ear_jax.errors import RunError
from ear_jax.presets import preset_config
from ear_jax.runs.trained import Trained

CURVE_POINTS = 20
UNKNOWN = "It has not been evaluated: which tasks it meets is not known."


def make_card(
    name: str, trained: Trained, command: str, rows: list[dict[str, Any]], evaluation: dict[str, Any] | None
) -> dict[str, Any]:
    """Returns all of an agent's card except the size and checksum of its file.

    Args:
      name: the agent's name.
      trained: its policy, a single seed.
      command: the `ear train` command that trained it, with all seeds of the run.
      rows: the run's metrics, all seeds.
      evaluation: the document of `ear evaluate --json` on the run, if there is one.

    Raises:
      RunError: the metrics lack a row for the policy's epoch.
    """
    config, about, family = trained.program.config, trained.about, trained.program.family
    rows = [row for row in rows if row["seed"] == config.seed and row["epoch"] <= trained.epoch]
    if not rows or rows[-1]["epoch"] != trained.epoch:
        raise RunError(f"{trained.name} is from epoch {trained.epoch}, for which metrics.jsonl has no row")
    last = rows[-1]
    if evaluation:
        measured = next(entry for entry in evaluation["seeds"] if entry["seed"] == config.seed)
        episodes, source = evaluation["episodes"], "evaluation.json"
        mean_return = measured["mean_return"]
        tasks = [judge(family, task, measured["tasks"]) for task in measured["tasks"]]
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
        "side_by_side": about.get("side_by_side", 1),  # seeds trained in these minutes
        "env_steps": last["env_steps"] + about.get("refined", {}).get("env_steps", 0),
        "updates": last["updates"],
        "minutes": round(last["seconds"] / 60, 1),
        "mean_return": mean_return,
        "returns_from": source,
        "episodes": episodes,  # for each task
        "limits": limits(tasks, episodes, family.unit) if evaluation else UNKNOWN,
        "tasks": tasks,
        "learning_curve": thinned(rows),
        **({"refined": about["refined"]} if "refined" in about else {}),
        **{key: about[key] for key in ("engine", "machine", "versions", "commit")},
    }


def judge(family: Family, task: dict[str, Any], all_tasks: list[dict[str, Any]]) -> dict[str, Any]:
    """Returns a task of an evaluation for the card; one with a target that others differ from also says if it is met.

    A task is met if every episode lasts and the achieved value is off by less than half the distance to the next task.
    """
    result = {
        "name": task["name"],
        "target": task["target"],
        "return": task["return_mean"],
        "failures": task["failures"],
    }
    if task["target"] is None:
        return {**result, "outcome": task["outcome"]}
    achieved = task["outcome"][family.commanded]
    others = [other["target"] for other in all_tasks if other["target"] not in (None, task["target"])]
    result |= {"achieved": achieved, "error": abs(family.difference(achieved, task["target"]))}
    if not others:
        return result
    gap = min(abs(family.difference(other, task["target"])) for other in others)
    return {**result, "met": result["error"] < gap / 2 and not task["failures"]}


def limits(tasks: list[dict[str, Any]], episodes: int, unit: str) -> str:
    """Describes which tasks an agent does not meet, and its outcomes on tasks without a target.

    Args:
      tasks: the card's tasks.
      episodes: episodes played for each task.
      unit: the unit of targets.
    """
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
    sentence = "; ".join(filter(None, parts))
    return f"{sentence[0].upper()}{sentence[1:]}."


def _means(outcome: dict[str, float]) -> str:
    return ", ".join(f"{name} {value:.2f}" for name, value in outcome.items())


def thinned(rows: list[dict[str, Any]]) -> list[dict[str, float]]:
    """Returns at most `CURVE_POINTS` rows of the metrics, evenly spaced and including the last."""
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


def command_line(config: Config) -> str:
    """Returns `ear train` with these settings, with flags for those that differ from today's preset.

    Engine and checkpoint settings are left out.
    """
    words = ["ear", "train", config.family]
    defaults = {**flat(preset_config(config.family, config.preset, config.agent)), "preset": "fast", "agent": "ear"}
    for name, value in flat(config).items():
        if value != defaults[name] and name.split(".")[0] not in ("engine", "checkpoint"):
            values = value if isinstance(value, tuple) else [value]
            words.append(f"--{name.replace('_', '-')}")
            words += [f"{item:g}" if isinstance(item, float) else str(item) for item in values]
    return shlex.join(words)
