"""How the search for a task's code went, epoch by epoch."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
from matplotlib.axes import Axes

from ear_jax.figures.style import STYLE, legend_below, look
from ear_jax.runs.records import folder


def draw_search(figures: Path, document: dict[str, Any]) -> list[Path]:
    """Draws what `ear adapt` found, a figure a seed; returns the paths, none where nothing was searched."""
    searched = [task for task in document["tasks"] if task["epochs"]]
    folder(figures)
    paths = []
    for seed in sorted({task["seed"] for task in searched}):
        with plt.rc_context(STYLE):
            figure, axes = plt.subplots(figsize=(4.6, 3.4), layout="constrained")
            for index, task in enumerate(task for task in searched if task["seed"] == seed):
                _draw_task(axes, index, task)
            axes.set(xlabel="epochs of search (0: none, from a map)", ylabel="return of an episode")
            legend_below(axes, 2)
            paths.append(figures / f"adaptation_seed{seed}.png")
            figure.savefig(paths[-1])
            plt.close(figure)
    return paths


def _draw_task(axes: Axes, index: int, task: dict[str, Any]) -> None:
    """The best of each epoch, and the same judged again by fresh episodes."""
    epochs, style = range(1, len(task["epochs"]) + 1), look(index)
    for name, what, line, fill in (
        ("reevaluated", "judged again", "-", "full"),
        ("best_of_epoch", "best candidate", "--", "none"),
    ):
        values = [epoch[name] for epoch in task["epochs"]]
        look_of = {**style, "linestyle": line, "fillstyle": fill}
        axes.plot(epochs, values, **look_of, markersize=4, linewidth=1.4, label=f"{task['name']}: {what}")
    if task["zero_shot"]:
        look_of = {**style, "linestyle": "none", "markersize": 8}
        axes.plot(0, task["zero_shot"]["reevaluated"], **look_of, label="_")
