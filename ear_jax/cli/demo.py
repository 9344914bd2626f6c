"""`ear demo`."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import jax
import numpy as np
from rich.console import Console
from rich.table import Table

from ear_jax import pretrained
from ear_jax.cli.arguments import option, parse
from ear_jax.cli.evaluate import keep_evaluation, print_evaluation
from ear_jax.cli.results import print_pictures
from ear_jax.embeddings.evaluate import evaluate
from ear_jax.embeddings.interpolate import Pair, adjacent_pairs, blend_codes, interpolate, play_blends, trained_ends
from ear_jax.embeddings.trajectory import follow
from ear_jax.errors import RunError, UsageError
from ear_jax.figures.strip import draw_strip
from ear_jax.presets import preset_config
from ear_jax.process.runtime import enable_cache
from ear_jax.process.terminal import phase, say
from ear_jax.rendering.film import arrange, photograph
from ear_jax.runs import records
from ear_jax.runs.loop import train_run
from ear_jax.runs.trained import Trained, load, policy_of

FAMILY = "halfcheetah-vel"
OUT = Path("runs/demo")
EPISODES = 10
SEARCH_EPISODES = 3  # per blend while the best is searched
SEED = 1  # of the starts in the evaluation
SECONDS = 5.0  # length of a roll-out in the picture, unless an episode is shorter


@dataclass(frozen=True)
class DemoCommand:
    """Train a small agent on three speeds and see it run at each, or see a pretrained agent blend two tasks."""

    pretrained: Annotated[tuple[str, ...] | None, option("[NAME]")] = None
    """Instead of training, play an agent that `ear pretrained` lists on two of its tasks and on a blend of them."""
    out: Annotated[Path, option("DIRECTORY", str(OUT))] = OUT
    """The run directory for training."""
    json: bool = False
    """Print one JSON document and nothing else."""


def main(words: list[str]) -> None:
    command = parse(DemoCommand, words, "demo")
    enable_cache()
    if command.pretrained is None:
        _train(command)
        return
    if len(command.pretrained) > 1:
        named = " ".join(command.pretrained)
        raise UsageError(f"--pretrained {named} names {len(command.pretrained)} agents; name one")
    if command.out != OUT:
        raise UsageError("--out applies only to training; --pretrained writes to runs/pretrained-NAME")
    name = (command.pretrained or (default_agent(),))[0].removeprefix(pretrained.PREFIX)
    document = show(load(Path(pretrained.PREFIX + name)), pretrained.card(name))
    if command.json:
        print(json.dumps(document))
    else:
        _print(document)


def _train(command: DemoCommand) -> None:
    train_run(preset_config(FAMILY, "smoke"), command.out)
    evaluation = evaluate(load(command.out), EPISODES, SEED)
    pictures = keep_evaluation(command.out, evaluation)
    tasks = [task for seed in evaluation["seeds"] for task in seed["tasks"]]
    error = float(np.mean([abs(speed - task["target"]) for task in tasks for speed in task["episodes"]["velocity"]]))
    if command.json:
        print(json.dumps({**evaluation, "mean_absolute_error": error, "figures": [str(path) for path in pictures]}))
        return
    print_evaluation(evaluation)
    print(f"mean error |achieved − commanded| over {EPISODES} fresh episodes per task: {error:.2f} m/s")
    print_pictures(pictures)
    _say_next(
        (f"ear interpolate {command.out} --between 1 2 --target 1.5", "a speed it was never trained on"),
        (f"ear adapt {command.out} --target 2.5", "another one, by search"),
        (f"ear train {FAMILY} --tasks 1 3 5", "speeds of your own"),
        (f"ear train {FAMILY}", "the ten speeds of the paper"),
    )


def default_agent() -> str:
    """Returns the agent to show if none is named: the one of the paper's first figures, or else the first."""
    names = pretrained.names()
    return FAMILY if FAMILY in names else next(iter(names), FAMILY)


def show(trained: Trained, card: dict[str, Any]) -> dict[str, Any]:
    """Blends two neighbouring tasks of a pretrained agent, plays them and the blend, and draws all three.

    Args:
      trained: the agent.
      card: its card, from which the two tasks are chosen.

    Returns:
      The document that `ear demo --pretrained --json` prints; `achieved` is the mean of fresh episodes, not of those
      that the blend was chosen by.

    Raises:
      UsageError: it does not have two tasks with targets.
      RunError: the picture cannot be written.
    """
    family = trained.program.family
    pair = best_pair(adjacent_pairs(trained_ends(trained), family), card)
    figures = records.folder(trained.directory / "figures")
    with phase(f"searching for the best blend of {pair[0].name} and {pair[1].name}"):
        best = interpolate(trained, [pair], None, SEARCH_EPISODES, seed=0)["pairs"][0]
    betas = (1.0, best["beta"], 0.0)
    with phase("playing both tasks and the blend in fresh episodes"):
        achieved = play_blends(trained, [pair], betas, EPISODES, SEED)[0, 0]
    names = [pair[0].name, f"β = {best['beta']:g}", pair[1].name]
    commanded = [pair[0].target, best["target"], pair[1].target]
    labels = [f"{name}\n{value:z.2f} {family.unit}" for name, value in zip(names, achieved, strict=True)]
    with phase("drawing"):
        picture = _draw(figures / "demo.png", trained, pair, betas, labels)
    return {
        "run": trained.name,
        "between": best["between"],
        "commanded": family.quantity,
        "episodes": EPISODES,
        "rows": [
            {"name": name, "beta": beta, "commanded": target, "achieved": float(value)}
            for name, beta, target, value in zip(names, betas, commanded, achieved, strict=True)
        ],
        "figures": [str(picture)],
    }


def best_pair(pairs: list[Pair], card: dict[str, Any]) -> Pair:
    """Returns the pair whose larger error on the card is smallest, or the first pair if the card has no evaluation.

    A task that the agent does not meet counts as infinitely far off.

    Raises:
      UsageError: there are no pairs.
    """
    if not pairs:
        other = f"`ear render pretrained:{card['name']} --task X` shows one task"
        raise UsageError(f"{card['name']} has no two tasks to blend; {other}")
    errors = {task["name"]: task["error"] for task in card["tasks"] if task.get("met")}
    return min(pairs, key=lambda pair: max(errors.get(end.name, float("inf")) for end in pair))


def _draw(path: Path, trained: Trained, pair: Pair, betas: tuple[float, ...], labels: list[str]) -> Path:
    """Draws the strip of the ends and the blend; without OpenGL as stick figures."""
    program, family = trained.program, trained.program.family
    codes = blend_codes(program.agent, pair[0].codes[0], pair[1].codes[0], betas)
    steps = min(family.episode_length, round(SECONDS / family.dt))
    trajectories = follow(program, policy_of(trained, 0), codes, steps, jax.random.key(SEED))
    strip = arrange(family.portrait(), trajectories, labels, family.dt)
    try:
        panels = photograph(strip)
    except RunError:
        panels = strip.panels
    return draw_strip(path, panels, strip.bounds, strip.caption)


def _print(document: dict[str, Any]) -> None:
    run, unit = document["run"], document["commanded"]["unit"]
    first, middle, second = document["rows"]
    table = Table(title=run, title_justify="left")
    for heading in ("", f"commanded ({unit})", f"achieved ({unit})"):
        table.add_column(heading, justify="right" if heading else "left")
    for row in document["rows"]:
        table.add_row(row["name"], f"{row['commanded']:.2f}", f"{row['achieved']:.2f}")
    Console(highlight=False).print(table)
    print(
        f"{middle['name']} blends the task embeddings (LTEs) of the two tasks; "
        f"the agent was never trained for {middle['commanded']:.4g} {unit}."
    )
    print(f"picture: {document['figures'][0]}")
    between = f"{first['name']} {second['name']}"
    _say_next(
        (f"ear interpolate {run} --all-pairs", "midway between all neighbouring tasks"),
        (f"ear render {run} --interpolate {between}", "films, and more blends"),
        (f"ear map {run}", "what the robot does under every LTE"),
        ("ear pretrained", "other agents, and the tasks they meet"),
    )


def _say_next(*examples: tuple[str, str]) -> None:
    """Suggests commands to try next, each with its purpose."""
    say("\nNext:")
    for example, purpose in examples:
        say(f"  {example:<60} {purpose}")
