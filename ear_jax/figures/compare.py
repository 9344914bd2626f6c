"""The figure of `ear compare`: the returns of two groups of runs, over all tasks and for each."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from ear_jax.figures.formats import write_figure
from ear_jax.figures.style import COLOURS, MARKERS, styled, subplots


def draw_compare(paths: Sequence[Path], document: dict[str, Any]) -> list[Path]:
    """Draws the document of `ear compare` into files and returns their paths."""
    with styled():
        width = 2.4 + min(7.0, 0.45 * len(document["tasks"]) + 1)
        figure, (whole, single) = subplots(
            1, 2, figsize=(width, 3.2), layout="constrained", width_ratios=(1, max(1.2, len(document["tasks"]) / 4))
        )
        _draw_whole(whole, document)
        _draw_tasks(single, document)
        chance = document["probability_of_improvement"]
        first, second = (group["name"] for group in document["groups"])
        figure.suptitle(f"A seed of {first} beats one of {second} with probability {chance['value']:.2f}", fontsize=9)
        return write_figure(figure, *paths)


def _draw_whole(axes: Axes, document: dict[str, Any]) -> None:
    """Draws means and interquartile means over all tasks, with their intervals."""
    statistics = ("mean", "interquartile_mean")
    for index, group in enumerate(document["groups"]):
        for place, name in enumerate(statistics):
            x, value = place + 0.16 * (2 * index - 1), group[name]["value"]
            look: Any = {"color": COLOURS[index], "marker": MARKERS[index]}
            axes.plot([x], [value], **look, linestyle="", label=group["name"] if place == 0 else "")
            if interval := group[name]["interval"]:
                axes.vlines(x, *interval, color=COLOURS[index], linewidth=1.6)
    axes.set_xticks(range(2), ["mean", "interquartile\nmean"])
    axes.set(xlim=(-0.5, 1.5), ylabel="return, over tasks and seeds", title="all tasks")


def _draw_tasks(axes: Axes, document: dict[str, Any]) -> None:
    """Draws each seed's return on each task as a dot, and their mean as a line."""
    tasks = document["tasks"]
    for index, group in enumerate(document["groups"]):
        places = np.arange(len(tasks)) + 0.16 * (2 * index - 1)
        returns = np.array(group["returns"])
        for seed in returns:
            axes.plot(places, seed, MARKERS[index], color=COLOURS[index], markersize=3, alpha=0.5)
        axes.hlines(returns.mean(axis=0), places - 0.13, places + 0.13, color=COLOURS[index], label=group["name"])
    axes.set_xticks(range(len(tasks)), tasks, rotation=90 if len(tasks) > 5 else 0)
    axes.set(title="each task: seeds, and their mean")
    axes.legend(frameon=False, fontsize=7)
