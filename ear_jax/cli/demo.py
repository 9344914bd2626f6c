"""`ear demo`."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from ear_jax import pretrained
from ear_jax.cli.arguments import parse
from ear_jax.cli.evaluate import keep_evaluation, print_evaluation
from ear_jax.embeddings.codes import blend
from ear_jax.embeddings.evaluate import evaluate
from ear_jax.embeddings.interpolate import Pair, adjacent_pairs, interpolate, play_blends, trained_ends
from ear_jax.embeddings.trajectory import follow
from ear_jax.errors import RunError, UsageError
from ear_jax.figures.strip import draw_strip
from ear_jax.presets import preset_config
from ear_jax.process.runtime import enable_cache
from ear_jax.process.terminal import phase, say
from ear_jax.rendering.film import arrange, photograph
from ear_jax.runs import records
from ear_jax.runs.loop import train_run
from ear_jax.runs.trained import Trained, load

FAMILY = "halfcheetah-vel"
OUT = Path("runs/demo")
EPISODES = 10
SEARCH_EPISODES = 3  # a blend that is tried
SEED = 1  # of the evaluation's starts
SECONDS = 5.0  # of a roll-out in the picture, unless an episode is shorter


@dataclass(frozen=True)
class DemoCommand:
    """Train a small agent on three speeds, here and now, and see it run at each; or see one that ships do a blend."""

    pretrained: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="[NAME]")] = None
    """Train nothing: an agent that `ear pretrained` lists, two of its tasks, and one between that it never saw."""
    out: Path = OUT
    """The run directory of what is trained."""
    json: bool = False
    """Print one JSON document and nothing else."""


def main(words: list[str]) -> None:
    command = parse(DemoCommand, words, "demo")
    enable_cache()
    if command.pretrained is None:
        _train(command)
        return
    if len(command.pretrained) > 1:
        raise UsageError(f"--pretrained {' '.join(command.pretrained)} are several; name one agent")
    if command.out != OUT:
        raise UsageError("--out is for what is trained; --pretrained writes to runs/pretrained-NAME")
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
    print(f"mean |achieved − commanded| speed over {EPISODES} fresh episodes per task: {error:.2f} m/s")
    print("pictures: " + ", ".join(str(path) for path in pictures))
    _say_next(
        (f"ear interpolate {command.out} --between 1 2 --target 1.5", "a speed it was never trained on"),
        (f"ear adapt {command.out} --target 2.5", "the same by search"),
        (f"ear train {FAMILY} --tasks 1 3 5", "speeds of your own"),
        (f"ear train {FAMILY}", "all ten of the paper's"),
    )


def default_agent() -> str:
    """The agent to show where none is named: the family of the paper's first figures, or else the first there is."""
    names = pretrained.names()
    return FAMILY if FAMILY in names else next(iter(names), FAMILY)


def show(trained: Trained, card: dict[str, Any]) -> dict[str, Any]:
    """Blends two neighbouring tasks of a pretrained agent, plays them and the blend, and draws all three.

    Args:
      trained: the agent.
      card: its card, which tells its best neighbours.

    Returns:
      What `ear demo --pretrained --json` prints; `achieved` is the mean of fresh episodes, not of those by which the
      blend was chosen.

    Raises:
      UsageError: no two of its tasks command anything.
      RunError: the picture cannot be written.
    """
    family = trained.program.family
    pair = best_pair(adjacent_pairs(trained_ends(trained), family), card)
    figures = records.folder(trained.directory / "figures")
    with phase(f"looking for a blend of {pair[0].name} and {pair[1].name}"):
        found = interpolate(trained, [pair], None, SEARCH_EPISODES, seed=0)["pairs"][0]
    betas = (1.0, found["beta"], 0.0)
    with phase("playing it and its ends in fresh episodes"):
        achieved = play_blends(trained, [pair], betas, EPISODES, SEED)[0, 0]
    names = [pair[0].name, f"β = {found['beta']:g}", pair[1].name]
    commanded = [pair[0].target, found["target"], pair[1].target]
    labels = [f"{name}\n{value:z.2f} {family.unit}" for name, value in zip(names, achieved, strict=True)]
    with phase("drawing"):
        picture = _draw(figures / "demo.png", trained, pair, betas, labels)
    return {
        "run": trained.name,
        "between": found["between"],
        "commanded": family.quantity,
        "episodes": EPISODES,
        "rows": [
            {"name": name, "beta": beta, "commanded": wanted, "achieved": float(value)}
            for name, beta, wanted, value in zip(names, betas, commanded, achieved, strict=True)
        ],
        "figures": [str(picture)],
    }


def best_pair(pairs: list[Pair], card: dict[str, Any]) -> Pair:
    """The neighbours that the card says are met best, by the worse of the two; raises UsageError where there are none.

    A card without an evaluation tells nothing, and the first are taken.
    """
    if not pairs:
        raise UsageError(f"{card['name']} has no two tasks to blend; see `ear render pretrained:{card['name']} --help`")
    errors = {task["name"]: task["error"] for task in card["tasks"] if task.get("met")}
    return min(pairs, key=lambda pair: max(errors.get(end.name, float("inf")) for end in pair))


def _draw(path: Path, trained: Trained, pair: Pair, betas: tuple[float, ...], labels: list[str]) -> Path:
    """The strip of the ends and the blend; without OpenGL as sticks."""
    program, family = trained.program, trained.program.family
    policy = jax.tree.map(lambda leaf: leaf[0], trained.policies)
    first, second = (jnp.asarray(end.codes[0]) for end in pair)
    codes = jnp.stack([blend(first, second, jnp.float32(beta), program.agent.project) for beta in betas])
    steps = min(family.episode_length, round(SECONDS / family.dt))
    strip = arrange(family.portrait(), follow(program, policy, codes, steps, jax.random.key(SEED)), labels, family.dt)
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
        f"{middle['name']} blends the two tasks' embeddings; nothing was trained for {middle['commanded']:.4g} {unit}."
    )
    print(f"picture: {document['figures'][0]}")
    between = f"{first['name']} {second['name']}"
    _say_next(
        (f"ear interpolate {run} --all-pairs", "midway between every two neighbours"),
        (f"ear render {run} --interpolate {between}", "films, and more blends"),
        (f"ear map {run}", "what every embedding does"),
        ("ear pretrained", "which others there are, and their limits"),
    )


def _say_next(*examples: tuple[str, str]) -> None:
    say("\nNext:")
    for example, what in examples:
        say(f"  {example:<60} {what}")
