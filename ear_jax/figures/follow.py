"""The figure of `ear follow`: what was wanted and what the robot did, by look-up and by the spline or pursuit."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from ear_jax.figures.style import COLOURS, legend_below, save_figure, styled, subplots
from ear_jax.files.replacing import folder


def draw_follow(figures: Path, document: dict[str, Any], label: str = "") -> list[Path]:
    """Draws one figure per seed and returns the paths.

    Args:
      figures: the folder to write into.
      document: the document of `ear follow`.
      label: a part of the names of the files.
    """
    folder(figures)
    draw = _draw_path if document["is_path"] else _draw_profile
    paths = []
    for entry in document["seeds"]:
        with styled():
            figure, axes = subplots(figsize=(4.6, 3.6), layout="constrained")
            draw(axes, entry, document)
            legend_below(axes, 3)
            paths.append(save_figure(figure, figures / f"following{label}_seed{entry['seed']}.png"))
    return paths


def _draw_profile(axes: Axes, entry: dict[str, Any], document: dict[str, Any]) -> None:
    moments = document["dt"] * np.arange(1, len(document["wanted"]) + 1)
    axes.plot(moments, document["wanted"], color="black", linestyle="--", linewidth=1.2, label="wanted")
    for colour, (name, way) in zip(COLOURS[1::-1], entry["ways"].items(), strict=True):
        axes.plot(moments, way["followed"], color=colour, linewidth=1.2, label=_label(name, way, document))
    axes.set(xlabel="seconds", ylabel=f"{document['outcomes'][0]} ({document['unit']})")


def _draw_path(axes: Axes, entry: dict[str, Any], document: dict[str, Any]) -> None:
    points = np.array(document["points"])[:, 1:]
    ends = np.concatenate([np.zeros((1, 2)), points])
    axes.plot(*ends.T, color="black", linestyle="--", linewidth=1.0, label="wanted")
    axes.plot(*points.T, "o", color="black", markersize=4)
    for colour, (name, way) in zip(COLOURS[1::-1], entry["ways"].items(), strict=True):
        axes.plot(*np.array(way["followed"]).T, color=colour, linewidth=1.2, label=_label(name, way, document))
    axes.set(xlabel="x (m)", ylabel="y (m)", aspect="equal")


def _label(name: str, way: dict[str, Any], document: dict[str, Any]) -> str:
    return f"{name}: {way['errors'][0]:.2f} {document['unit']}"
