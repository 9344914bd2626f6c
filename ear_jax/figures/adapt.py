"""The figure of `ear adapt`: the course of the search, epoch by epoch."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from matplotlib.axes import Axes

from ear_jax.figures.style import legend_below, look, save_figure, styled, subplots
from ear_jax.files.replacing import folder


def draw_adapt(figures: Path, document: dict[str, Any], label: str = "") -> list[Path]:
    """Draws one figure per seed and returns the paths; draws none if there was no search.

    Args:
      figures: the folder to write into.
      document: the document of `ear adapt`.
      label: a part of the names of the files.
    """
    searched = [task for task in document["tasks"] if task["epochs"]]
    folder(figures)
    paths = []
    for seed in sorted({task["seed"] for task in searched}):
        with styled():
            figure, axes = subplots(figsize=(4.6, 3.4), layout="constrained")
            for index, task in enumerate(task for task in searched if task["seed"] == seed):
                _draw_task(axes, index, task)
            axes.set(xlabel="epochs of search (0: LTE without a search)", ylabel="return of an episode")
            legend_below(axes, 2)
            paths.append(save_figure(figure, figures / f"adaptation{label}_seed{seed}.png"))
    return paths


def _draw_task(axes: Axes, index: int, task: dict[str, Any]) -> None:
    """Draws the best candidate of each epoch, its return in fresh episodes, and the answers without a search."""
    epochs, style = range(1, len(task["epochs"]) + 1), look(index)
    for name, label, line, fill in (
        ("reevaluated", "in fresh episodes", "-", "full"),
        ("best_of_epoch", "best candidate", "--", "none"),
    ):
        values = [epoch[name] for epoch in task["epochs"]]
        line_style = {**style, "linestyle": line, "fillstyle": fill}
        axes.plot(epochs, values, **line_style, markersize=4, linewidth=1.4, label=f"{task['name']}: {label}")
    answers = [way for name, way in task["answers"].items() if name != "search"] if "answers" in task else []
    for answer in answers or filter(None, [task.get("zero_shot")]):
        axes.plot(0, answer["reevaluated"], **{**style, "linestyle": "none", "markersize": 8}, label="_")
