"""The figures of `ear evaluate`: the learning curve, and the achieved against the commanded quantity."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes

from ear_jax.figures.style import COLOURS, save_figure, styled, subplots
from ear_jax.files.replacing import folder


def draw_evaluate(
    figures: Path, evaluation: dict[str, Any], label: str = "", *, rows: list[dict[str, Any]]
) -> list[Path]:
    """Draws the figures that there are data for, and returns the paths.

    Args:
      figures: the folder to write into.
      evaluation: the document of `ear evaluate`.
      label: a part of the names of files about the evaluation.
      rows: the run's metrics, for the learning curve.
    """
    folder(figures)
    drawn = []
    if rows:
        drawn.append(_draw(figures / "learning_curve.png", (4.5, 3.0), lambda axes: learning_curve(axes, rows)))
    if any(task["target"] is not None for task in evaluation["seeds"][0]["tasks"]):
        points = figures / f"commanded_achieved{label}.png"
        drawn.append(_draw(points, (3.6, 3.4), lambda axes: commanded_against_achieved(axes, evaluation)))
    return drawn


def _draw(path: Path, inches: tuple[float, float], draw: Callable[[Axes], None]) -> Path:
    with styled():
        figure, axes = subplots(figsize=inches)
        draw(axes)
        return save_figure(figure, path)


def learning_curve(axes: Axes, rows: list[dict[str, Any]]) -> None:
    """Draws the mean evaluation return against wall time, one line per seed."""
    for index, seed in enumerate(sorted({row["seed"] for row in rows})):
        own = [row for row in rows if row["seed"] == seed]
        minutes = [row["seconds"] / 60 for row in own]
        colour = COLOURS[index % len(COLOURS)]
        axes.plot(minutes, [row["mean_return"] for row in own], color=colour, marker=".", label=f"seed {seed}")
    last = rows[-1]
    steps = f"{last['env_steps']:,} env steps and {last['updates']:,} updates per seed"
    axes.set(xlim=(0, None), xlabel="wall time (min)", ylabel="return, mean over tasks", title=steps)
    axes.legend(frameon=False)


def commanded_against_achieved(axes: Axes, evaluation: dict[str, Any]) -> None:
    """Draws one point per evaluation episode; points on the line achieve their target."""
    name, unit = evaluation["commanded"]["outcome"], evaluation["commanded"]["unit"]
    for index, seed in enumerate(evaluation["seeds"]):
        tasks = [task for task in seed["tasks"] if task["target"] is not None]
        points = [(task["target"], value) for task in tasks for value in task["episodes"][name]]
        commanded, achieved = zip(*points, strict=True)
        colour = COLOURS[index % len(COLOURS)]
        axes.scatter(commanded, achieved, color=colour, s=18, alpha=0.7, label=f"seed {seed['seed']}", zorder=3)
    low, high = min(0, axes.get_xlim()[0], axes.get_ylim()[0]), max(axes.get_xlim()[1], axes.get_ylim()[1])
    axes.plot((low, high), (low, high), color="0.5", linewidth=1, label="as commanded")
    axes.set(
        xlim=(low, high),
        ylim=(low, high),
        aspect="equal",
        xlabel=f"commanded {name} ({unit})",
        ylabel=f"achieved {name} ({unit})",
    )
    axes.legend(frameon=False, loc="upper left")
