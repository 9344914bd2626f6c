"""The figure of `ear front`: two rewards under every surveyed LTE, and the Pareto front."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ear_jax.errors import plain
from ear_jax.figures.style import look, save_figure, styled, subplots
from ear_jax.files.replacing import folder


def draw_front(figures: Path, document: dict[str, Any], label: str = "") -> list[Path]:
    """Draws one figure per seed and returns the paths.

    Args:
      figures: the folder to write into.
      document: the document of `ear front`.
      label: a part of the names of the files.
    """
    folder(figures)
    return [
        _draw(figures / f"front{label}_seed{entry['seed']}.png", entry, document["rewards"])
        for entry in document["seeds"]
    ]


def _draw(path: Path, entry: dict[str, Any], rewards: list[str]) -> Path:
    played, trained = np.array(entry["rewards"]), np.array([task["rewards"] for task in entry["trained"]])
    front, colour = played[entry["front"]], look(0)["color"]
    with styled():
        figure, axes = subplots(figsize=(6.4, 4.0), layout="constrained")
        axes.scatter(played[:, 0], played[:, 1], s=4, color="0.7", linewidths=0, label="an LTE")
        axes.step(*front.T, where="post", color=colour, label="Pareto front")
        axes.plot(*front.T, "o", markersize=3, color=colour)
        axes.plot(*trained.T, "x", markersize=5, color="black", label="LTE of a training task")
        for place, names in _named(trained, [plain(task["name"]) for task in entry["trained"]], np.ptp(played, axis=0)):
            axes.annotate(names, tuple(place), (3, 3), textcoords="offset points", fontsize=6)
        axes.set(xlabel=f"{plain(rewards[0])}, mean a step", ylabel=f"{plain(rewards[1])}, mean a step")
        axes.legend(fontsize=7)
        return save_figure(figure, path)


def _named(places: np.ndarray, names: list[str], ranges: np.ndarray) -> list[tuple[np.ndarray, str]]:
    """Joins the names of places [n, 2] that are too near for labels of their own: 4 % of the ranges [2] of the axes."""
    joined: list[tuple[np.ndarray, str]] = []
    for place, name in zip(places, names, strict=True):
        if joined and bool((np.abs(place - joined[-1][0]) < 0.04 * ranges).all()):
            joined[-1] = joined[-1][0], f"{joined[-1][1]}, {name}"
        else:
            joined.append((place, name))
    return joined
