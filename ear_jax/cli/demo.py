"""`ear demo`."""

from __future__ import annotations

import json
import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from ear_jax import pretrained
from ear_jax.cli.arguments import option, parse
from ear_jax.cli.closing import say_next
from ear_jax.cli.evaluate import keep_evaluation, print_evaluation
from ear_jax.cli.on_run import load_run
from ear_jax.cli.results import print_pictures, print_table
from ear_jax.errors import UsageError
from ear_jax.process.environment import start_jax
from ear_jax.process.terminal import phase, sign_of_life
from ear_jax.runs.directory import check_place

FAMILY = "halfcheetah-vel"
OUT = Path("runs/demo")
EPISODES = 10
SEED = 1  # of the starts in the evaluation


@dataclass(frozen=True)
class DemoCommand:
    """Train a small agent on three speeds and see it run at each, or see a pretrained agent blend two tasks.

    Example: ear demo --pretrained hopper-vel
    """

    pretrained: Annotated[tuple[str, ...] | None, option("[NAME]")] = None
    """Instead of training, play an agent that `ear pretrained` lists on two of its tasks and on a blend of them."""
    out: Annotated[Path, option("DIRECTORY", str(OUT))] = OUT
    """The run directory for training."""
    json: bool = False
    """Print one JSON document and nothing else."""


def main(words: list[str]) -> None:
    command = parse(DemoCommand, words, "demo")
    if command.pretrained is None:
        _train(command)
        return
    if len(command.pretrained) > 1:
        named = " ".join(command.pretrained)
        raise UsageError(f"--pretrained {named} names {len(command.pretrained)} agents; name one")
    if command.out != OUT:
        raise UsageError("--out applies only to training; --pretrained writes to runs/pretrained-NAME")
    name = (command.pretrained or (default_agent(),))[0].removeprefix(pretrained.PREFIX)
    trained = load_run(Path(pretrained.PREFIX + name), None, None)
    from ear_jax.cli.showing import show

    document = show(trained, pretrained.card(name))
    if command.json:
        print(json.dumps(document))
    else:
        _print(document)


def _train(command: DemoCommand) -> None:
    check_place(command.out)
    with sign_of_life("loading"):
        start_jax()
        from ear_jax.cli.showing import draw_tasks
        from ear_jax.embeddings.evaluate import evaluate
        from ear_jax.presets import preset_config
        from ear_jax.runs.loop import train_run

    train_run(preset_config(FAMILY, "smoke"), command.out)
    trained = load_run(command.out, None, None)
    with phase(f"playing {EPISODES} episodes of each task"):
        evaluation = evaluate(trained, EPISODES, SEED)
    pictures = [*keep_evaluation(command.out, evaluation, "_demo"), draw_tasks(trained, evaluation)]
    tasks = [task for seed in evaluation["seeds"] for task in seed["tasks"]]
    errors = [abs(speed - task["target"]) for task in tasks for speed in task["episodes"]["velocity"]]
    error = sum(errors) / len(errors)
    if command.json:
        print(json.dumps({**evaluation, "mean_absolute_error": error, "figures": [str(path) for path in pictures]}))
        return
    print_evaluation(evaluation)
    print(f"mean error |achieved − commanded| over {EPISODES} fresh episodes per task: {error:.2f} m/s")
    print_pictures(pictures)
    print(f"{pictures[-1]} shows the robot at each speed")
    run = shlex.quote(str(command.out))
    say_next(
        (f"interpolate {run} --between 1 2 --target 1.5", "a speed it was never trained on"),
        (f"render {run} --task 1 2 3", "films of the robot"),
        (f"adapt {run} --target 2.5", "another speed, by search"),
        (f"train {FAMILY}", "the ten speeds of the paper"),
    )


def default_agent() -> str:
    """Returns the agent to show if none is named: the one of the paper's first figures, or else the first."""
    names = pretrained.names()
    return FAMILY if FAMILY in names else next(iter(names), FAMILY)


def _print(document: dict[str, Any]) -> None:
    run, unit = document["run"], document["commanded"]["unit"]
    first, middle, second = document["rows"]
    rows = [(row["name"], f"{row['commanded']:.2f}", f"{row['achieved']:.2f}") for row in document["rows"]]
    print_table(("task", f"commanded ({unit})>", f"achieved ({unit})>"), rows, run)
    print(
        f"{middle['name']} blends the task embeddings (LTEs) of the two tasks; "
        f"the agent was never trained for {middle['commanded']:.4g} {unit}."
    )
    print(f"picture: {document['figures'][0]}")
    between = f"{first['name']} {second['name']}"
    say_next(
        (f"interpolate {run} --all-pairs", "midway between all neighbouring tasks"),
        (f"render {run} --interpolate {between}", "films, and more blends"),
        (f"map {run}", "what the robot does under every LTE"),
        ("pretrained", "other agents, and the tasks they meet"),
    )
