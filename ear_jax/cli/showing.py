"""An agent seen at work for `ear demo`: on its tasks, or on two of them and on a blend."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jax

from ear_jax.embeddings.interpolate import Pair, adjacent_pairs, blend_codes, interpolate, play_blends, trained_ends
from ear_jax.embeddings.trajectory import follow
from ear_jax.errors import RunError, UsageError
from ear_jax.figures.strip import draw_strip
from ear_jax.process.terminal import phase
from ear_jax.rendering.film import arrange, photograph
from ear_jax.runs import records
from ear_jax.runs.trained import Trained, policy_of

EPISODES = 10
SEARCH_EPISODES = 3  # per blend while the best is searched
SEED = 1  # of the starts in the evaluation
SECONDS = 5.0  # length of a roll-out in the picture, unless an episode is shorter


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
    codes = blend_codes(trained.program.agent, pair[0].codes[0], pair[1].codes[0], betas)
    with phase("drawing"):
        picture = _draw(figures / "demo.png", trained, codes, labels)
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


def draw_tasks(trained: Trained, evaluation: dict[str, Any]) -> Path:
    """Draws a run's first policy on its training tasks, beneath what an evaluation found, and returns the path.

    Raises:
      RunError: the picture cannot be written.
    """
    program, quantity = trained.program, evaluation["commanded"]
    found = [task["outcome"][quantity["outcome"]] for task in evaluation["seeds"][0]["tasks"]]
    labels = [
        f"{name}\n{value:z.2f} {quantity['unit']}" for name, value in zip(program.tasks.names, found, strict=True)
    ]
    figures = records.folder(trained.directory / "figures")
    with phase("drawing"):
        return _draw(figures / "demo.png", trained, program.agent.codes(policy_of(trained, 0)), labels)


def _draw(path: Path, trained: Trained, codes: jax.Array, labels: list[str]) -> Path:
    """Draws the strip of a run's first policy under codes [rows, code]; without OpenGL as stick figures."""
    program, family = trained.program, trained.program.family
    steps = min(family.episode_length, round(SECONDS / family.dt))
    trajectories = follow(program, policy_of(trained, 0), codes, steps, jax.random.key(SEED))
    strip = arrange(family.portrait(), trajectories, labels, family.dt)
    try:
        panels = photograph(strip)
    except RunError:
        panels = strip.panels
    return draw_strip(path, panels, strip.bounds, strip.caption, strip.beside)
