"""`ear demo`."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ear_jax.cli.arguments import parse
from ear_jax.cli.evaluate import keep_evaluation, print_evaluation
from ear_jax.config import preset_config
from ear_jax.evaluate import evaluate
from ear_jax.run import train_run
from ear_jax.runtime import enable_cache
from ear_jax.terminal import say
from ear_jax.trained import load

FAMILY = "halfcheetah-vel"
EPISODES = 10
SEED = 1  # of the evaluation's starts


@dataclass(frozen=True)
class DemoCommand:
    """Train a small agent on three speeds, here and now, and see it run at each."""

    out: Path = Path("runs/demo")
    """The run directory."""
    json: bool = False
    """Print one JSON document and nothing else."""


def main(words: list[str]) -> None:
    command = parse(DemoCommand, words, "demo")
    enable_cache()
    train_run(preset_config(FAMILY, "smoke"), command.out)
    evaluation = evaluate(load(command.out), EPISODES, SEED)
    pictures = keep_evaluation(command.out, evaluation)
    tasks = [task for seed in evaluation["seeds"] for task in seed["tasks"]]
    error = float(np.mean([abs(speed - task["target"]) for task in tasks for speed in task["episodes"]["velocity"]]))
    if command.json:
        print(json.dumps({**evaluation, "mean_absolute_error": error, "figures": [str(path) for path in pictures]}))
        return
    print_evaluation(evaluation)
    print(f"mean |achieved − commanded| speed over {EPISODES} fresh episodes per task: {error:.2f} m/s")
    print("pictures: " + ", ".join(str(path) for path in pictures))
    say("\nNext:")
    for example, what in (
        (f"ear interpolate {command.out} --between 1 2 --target 1.5", "a speed it was never trained on"),
        (f"ear adapt {command.out} --target 2.5", "the same by search"),
        (f"ear train {FAMILY} --tasks 1 3 5", "speeds of your own"),
        (f"ear train {FAMILY}", "all ten of the paper's"),
    ):
        say(f"  {example:<60} {what}")
