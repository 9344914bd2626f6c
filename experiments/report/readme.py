"""README's table of results, made from the records, between two markers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from experiments.paper import ADAPTATION, CHEETAH, FAMILIES, INTERPOLATION, REACH, RUN_JUMP, Analysis
from experiments.report import documents
from experiments.report.blocks import Table
from experiments.report.found import Found, Run
from experiments.report.markdown import table
from experiments.report.measures import mean_return, paper_budget, paper_counts, paper_return, successes, unit
from experiments.report.sections import machine
from experiments.report.words import MISSING, NAMES, count, number, printed, seeds, span, spread

README = Path(__file__).parents[2] / "README.md"
PLACE = "results"
MILESTONES = {CHEETAH: (-250, -200, -170)}  # returns, and when training passed them
SUCCESS = {"mid_task": "a β meets the value midway", "one_to_one": "β = ½ gives a value between"}


def rewrite(found: Found) -> None:
    """Puts the results into README; raises RunError where it has no place for them, or cannot be written."""
    documents.put(README, PLACE, results(found))


def results(found: Found) -> str:
    """What stands between the markers: EAR's returns, interpolation and adaptation, and notes on the runs."""
    families = (*FAMILIES, RUN_JUMP, REACH)
    rows = [row for family in families for row in _family(family, found.runs(family))]
    runs = [run for family in families for run in found.runs(family)]
    parts = [table(Table("", ("what", "command", "here", "the paper"), rows)), *_machines(runs), *map(_note, runs)]
    return "\n\n".join(filter(None, parts))


def _family(family: str, runs: list[Run]) -> list[list[str]]:
    if not runs:
        return []
    paper = paper_return(family, "ear")
    reached = f"{spread([mean_return(run) for run in runs])} ({seeds(runs)}; {_spent([run.last for run in runs])})"
    theirs = "a curve, no number" if family == REACH else MISSING
    if paper:
        steps, updates = map(count, paper_budget(family))
        theirs = f"{printed(paper)} (3 seeds; {steps} env steps, {updates} updates)"
    rows = [[f"{NAMES[family]}, return", f"`{runs[0].command}`", reached, theirs], *_passed(family, runs)]
    for what, words in SUCCESS.items():
        counted = successes(runs, what)
        if counted:
            pairs = f"{counted} pairs ({seeds(counted.seeds)})"
            theirs = paper_counts(family, what)
            rows.append([f"… {words}", _on_run(INTERPOLATION), pairs, printed(theirs) if theirs else MISSING])
    return rows + _adapted(family, runs)


def _passed(family: str, runs: list[Run]) -> list[list[str]]:
    """When the mean return in training passed the family's milestones, where that of every run did."""
    rows = []
    for level in MILESTONES.get(family, ()):
        first = [next((row for row in run.rows if row["mean_return"] >= level), None) for run in runs]
        reached = [row for row in first if row]
        if len(reached) == len(runs):
            rows.append([f"… passes {number(level, 0)} in training", "", _spent(reached), MISSING])
    return rows


def _spent(rows: list[dict[str, Any]]) -> str:
    """The budget of rows of metrics, from the least to the most."""
    minutes = span([row["seconds"] / 60 for row in rows], number)
    steps, updates = (span([row[key] for row in rows], count) for key in ("env_steps", "updates"))
    return f"{minutes} min, {steps} env steps, {updates} updates"


def _on_run(analysis: Analysis) -> str:
    return f"`{' '.join(['ear', analysis.command, 'RUN', *analysis.options])}`"


def _adapted(family: str, runs: list[Run]) -> list[list[str]]:
    tasks = [task for run in runs for task in run.of_seed(ADAPTATION.name, "tasks")]
    searched = [task["epochs"][2]["reevaluated"] for task in tasks if len(task["epochs"]) > 2]
    errors = [task["zero_shot"]["error"] for task in tasks if task.get("zero_shot")]
    rows = []
    if searched:
        value = f"{number(float(np.mean(searched)))} on {len(searched)} unseen tasks"
        theirs = "no number; converged by then" if family in FAMILIES else MISSING
        rows.append(["… return after 3 epochs of search", _on_run(ADAPTATION), value, theirs])
    if errors:
        mean = number(float(np.mean(errors)), 2)
        value = f"{mean} {unit(family)} on {len(errors)} unseen tasks, at most {number(max(errors), 2)}"
        rows.append(["… error without search, mean", _on_run(ADAPTATION), value, MISSING])
    return rows


def _machines(runs: list[Run]) -> list[str]:
    """What each family was trained on, in a sentence; none without runs."""
    families: dict[str, list[str]] = {}
    for run in runs:
        families.setdefault(machine(run), []).append(NAMES[run.config.family])
    said = "; ".join(f"{', '.join(dict.fromkeys(names))} on {where}" for where, names in families.items())
    return [f"Trained: {said}."] if said else []


def _note(run: Run) -> str:
    """Of a run that was stopped before its end, or whose preset is another today; otherwise empty."""
    last, config, said = run.last, run.config, []
    if last["epoch"] < config.epochs and not (config.minutes and last["seconds"] >= 60 * config.minutes):
        said.append(f"was stopped at epoch {count(last['epoch'])} of {count(config.epochs)}")
    if run.changes:
        settings = ", ".join(f"`{name}` {value}" for name, value in run.changes.items())
        said.append(f"has settings that `{config.preset}` has otherwise today: {settings}")
    return f"`{run.name}`, of commit {run.made['commit']}, {'; it '.join(said)}." if said else ""
