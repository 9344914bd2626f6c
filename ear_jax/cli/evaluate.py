"""`ear evaluate RUN`."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from ear_jax.cli.arguments import check_least, option, parse
from ear_jax.cli.on_run import OnRun
from ear_jax.cli.results import keep, label_of, print_table, show_and_keep
from ear_jax.embeddings import ltes
from ear_jax.errors import counted, plain
from ear_jax.process.terminal import phase, say
from ear_jax.runs import records

MOST_NAMED = 30  # tasks with episodes that ended early, which one line names


@dataclass(frozen=True, kw_only=True)
class EvaluateCommand(OnRun):
    """Play a run's newest policy without exploration, on its training tasks or under any task embedding (LTE).

    Example: ear evaluate pretrained:halfcheetah-vel --episodes 10
    """

    episodes: int = 3
    """Episodes per task."""
    lte: Annotated[tuple[str, ...], option("NAME|X Y Z", "the training tasks' LTEs")] = ()
    """An LTE saved by `ear adapt --save`, or its numbers."""


def main(words: list[str]) -> None:
    command = parse(EvaluateCommand, words, "evaluate")
    check_least(command, episodes=1)
    trained = command.load()
    import jax.numpy as jnp

    from ear_jax.embeddings.evaluate import evaluate, evaluate_code

    if command.lte:
        seeds, size = trained.program.config.seeds, trained.program.agent.code_size
        codes = jnp.array(ltes.find(trained.directory, command.lte, seeds, size, trained.fingerprint))
        with phase(f"playing {counted(command.episodes, 'episode')}"):
            document = evaluate_code(trained, codes, command.episodes, command.seed)
        if command.json:
            print(json.dumps(document))
        else:
            _print_code(document)
        return
    with phase(f"playing {counted(command.episodes, 'episode')} of {counted(len(trained.program.tasks), 'task')}"):
        document = evaluate(trained, command.episodes, command.seed)
    kept = partial(keep_evaluation, trained.directory, document, label_of(command))
    show_and_keep(document, command.json, print_evaluation, kept)


def _print_code(document: dict[str, Any]) -> None:
    quantity, unit = document["commanded"]["outcome"], document["commanded"]["unit"]
    for entry in document["seeds"]:
        outcome = entry["outcome"]
        others = ", ".join(f"{name} {value:.2f}" for name, value in outcome.items() if name != quantity)
        steps = f"episodes of {entry['length']:.0f} steps"
        print(f"seed {entry['seed']}: {quantity} {outcome[quantity]:.2f} {unit}, {others}, {steps}")


def keep_evaluation(run: Path, evaluation: dict[str, Any], label: str = "") -> list[Path]:
    """Writes an evaluation into its run's directory and draws the run's figures; returns their paths.

    `evaluation.json`, which cards and comparisons read, is always the latest.
    """
    from ear_jax.figures.evaluate import draw_evaluate  # matplotlib takes a second to import

    rows = records.read_rows(run / "metrics.jsonl", say, records.METRICS)
    if label:
        keep(run, "evaluation", "", evaluation, lambda *_: [])
    return keep(run, "evaluation", label, evaluation, partial(draw_evaluate, rows=rows))


def print_evaluation(evaluation: dict[str, Any]) -> None:
    """Prints a table of the tasks, with one number per seed, and the episodes that ended early."""
    commanded, rows = evaluation["commanded"], []
    for tasks in zip(*(seed["tasks"] for seed in evaluation["seeds"]), strict=True):
        achieved = " / ".join(f"{task['outcome'][commanded['outcome']]:.2f}" for task in tasks)
        returns = " / ".join(f"{task['return_mean']:.1f}" for task in tasks)
        failures = " / ".join(str(task["failures"]) for task in tasks)
        rows.append((tasks[0]["name"], achieved, returns, failures))
    headings = ("task", f"{commanded['outcome']} ({commanded['unit']})>", "return>", "ended early>")
    print_table(headings, rows, f"{evaluation['run']}: mean return {evaluation['mean_return']:.1f}")
    if "untuned_return" in evaluation["seeds"][0]:
        shared = " / ".join(f"{seed['untuned_return']:.1f}" for seed in evaluation["seeds"])
        print(f"Before the gradient step in each task: mean return {shared}")
    print(plain(ended_early(evaluation)))


def ended_early(evaluation: dict[str, Any]) -> str:
    """Summarises in one line the tasks that had episodes which ended before the time limit."""
    several, episodes = len(evaluation["seeds"]) > 1, evaluation["episodes"]
    tasks = [
        (f"{task['name']} (seed {seed['seed']})" if several else task["name"], task["failures"])
        for seed in evaluation["seeds"]
        for task in seed["tasks"]
    ]
    early = [f"{name} {count} of {episodes}" for name, count in tasks if count]
    if not early:
        return f"All {len(tasks) * episodes} episodes ran their {evaluation['episode_length']} steps"
    others = [f"and {len(early) - MOST_NAMED} more tasks"] if len(early) > MOST_NAMED else []
    return f"Episodes ended early in {len(early)} of {len(tasks)} tasks: {', '.join(early[:MOST_NAMED] + others)}"
