"""`ear evaluate RUN`."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax.numpy as jnp
from rich.console import Console
from rich.table import Table

from ear_jax.cli.arguments import check_least, parse
from ear_jax.cli.on_run import OnRun
from ear_jax.embeddings import ltes
from ear_jax.embeddings.evaluate import evaluate, evaluate_code
from ear_jax.figures.evaluate import draw_run
from ear_jax.runs import records


@dataclass(frozen=True, kw_only=True)
class EvaluateCommand(OnRun):
    """Play a run's newest policy on its training tasks, or under any LTE, without exploration."""

    episodes: int = 3
    """Episodes per task."""
    lte: tuple[str, ...] = ()
    """Instead of the tasks' LTEs: one saved by `ear adapt --save`, or its numbers."""


def main(words: list[str]) -> None:
    command = parse(EvaluateCommand, words, "evaluate")
    check_least(command, episodes=1)
    trained = command.load()
    if command.lte:
        seeds, size = trained.program.config.seeds, trained.program.agent.code_size
        codes = jnp.array(ltes.find(trained.directory, command.lte, seeds, size, trained.fingerprint))
        _print_code(evaluate_code(trained, codes, command.episodes, command.seed), command.json)
        return
    evaluation = evaluate(trained, command.episodes, command.seed)
    keep_evaluation(trained.directory, evaluation)
    if command.json:
        print(json.dumps(evaluation))
    else:
        print_evaluation(evaluation)


def _print_code(document: dict[str, Any], as_json: bool) -> None:
    if as_json:
        print(json.dumps(document))
        return
    quantity, unit = document["commanded"]["outcome"], document["commanded"]["unit"]
    for one in document["seeds"]:
        others = ", ".join(f"{name} {value:.2f}" for name, value in one["outcome"].items() if name != quantity)
        lasted = f"episodes of {one['length']:.0f} steps"
        print(f"seed {one['seed']}: {quantity} {one['outcome'][quantity]:.2f} {unit}, {others}, {lasted}")


def keep_evaluation(run: Path, evaluation: dict[str, Any]) -> list[Path]:
    """Writes an evaluation into its run's directory and draws the run's figures anew; returns their paths."""
    records.write_json(run / "evaluation.json", {**evaluation, **records.provenance()})
    return draw_run(run, records.read_rows(run / "metrics.jsonl"), evaluation)


def print_evaluation(evaluation: dict[str, Any]) -> None:
    """A table of the tasks, with a number a seed, and how many tasks failed."""
    measured = evaluation["commanded"]
    table = Table(title=f"{evaluation['run']}: mean return {evaluation['mean_return']:.1f}", title_justify="left")
    for heading in ("task", f"{measured['outcome']} ({measured['unit']})", "return", "failed"):
        table.add_column(heading, justify="left" if heading == "task" else "right")
    for tasks in zip(*(seed["tasks"] for seed in evaluation["seeds"]), strict=True):
        achieved = " / ".join(f"{task['outcome'][measured['outcome']]:.2f}" for task in tasks)
        returns = " / ".join(f"{task['return_mean']:.1f}" for task in tasks)
        failures = " / ".join(str(task["failures"]) for task in tasks)
        table.add_row(tasks[0]["name"], achieved, returns, failures)
    console, failed = Console(highlight=False), evaluation["failed_tasks"]
    console.print(table)
    each = f"an episode of {evaluation['episodes']} that ended before {evaluation['episode_length']} steps"
    console.print(f"{failed['failed']} of {failed['total']} tasks had {each}")
