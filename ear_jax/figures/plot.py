"""The figure of `ear plot`: a metric of several runs as curves, the seeds of one kind as a band."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes

from ear_jax.figures.formats import write_figure
from ear_jax.figures.style import COLOURS, LINES, styled, subplots
from ear_jax.runs.groups import Group, band

LABELS = {"updates": "updates", "steps": "env steps", "minutes": "wall time (min)"}


def draw_plot(paths: Sequence[Path], groups: Sequence[Group], metric: str, by: str) -> list[Path]:
    """Draws one figure into files of different formats and returns their paths.

    Args:
      paths: the files; their endings are formats of Matplotlib.
      groups: a curve each.
      metric: a name of `runs.groups.metric_names`.
      by: an axis of `runs.groups.AXES`.
    """
    with styled():
        figure, axes = subplots(figsize=(5.4, 3.4), layout="constrained")
        for index, members in enumerate(groups):
            draw_band(axes, members, metric, by, index)
        axes.set(xlim=(0, None), xlabel=LABELS[by], ylabel=axis_label(metric))
        axes.legend(frameon=False, fontsize=7)
        return write_figure(figure, *paths)


def draw_band(axes: Axes, members: Group, metric: str, by: str, index: int) -> None:
    """Draws the mean over a group's seeds as a line, and the range from lowest to highest seed as a band."""
    places, values = band(members, metric, by)
    look: Any = {"color": COLOURS[index % len(COLOURS)], "linestyle": LINES[index // len(COLOURS) % len(LINES)]}
    seeds = f" ({len(values)} seeds)" if len(values) > 1 else ""
    axes.plot(places, values.mean(axis=0), **look, linewidth=1.4, label=members.name + seeds)
    if len(values) > 1:
        axes.fill_between(places, values.min(axis=0), values.max(axis=0), color=look["color"], alpha=0.2, linewidth=0)


def axis_label(metric: str) -> str:
    """Returns a metric's name as the label of an axis."""
    if metric == "mean_return":
        return "return, mean over tasks"
    return metric.replace("_", " ")
