"""The figure of `ear interpolate`: the achievement of blends along β, and the blend nearest to the target."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from ear_jax.figures.style import COLOURS, legend_below, look, save_figure, styled, subplots
from ear_jax.files.replacing import folder


def draw_interpolate(figures: Path, document: dict[str, Any], label: str = "") -> list[Path]:
    """Draws one figure per seed and returns the paths.

    Args:
      figures: the folder to write into.
      document: the document of `ear interpolate`, with `pairs` or, for given β, with `blends`.
      label: a part of the names of the files.
    """
    folder(figures)
    kind, draw = ("pairs", _draw_pairs) if "pairs" in document else ("blends", _draw_betas)
    paths = []
    for seed in sorted({row["seed"] for row in document[kind]}):
        rows = [row for row in document[kind] if row["seed"] == seed]
        with styled():
            width = 2.5 + min(6.0, 0.8 * len(rows)) if kind == "pairs" else 4.3
            figure, axes = subplots(figsize=(width, 3.2), layout="constrained")
            draw(axes, rows, document)
            axes.set(ylabel=f"{document['commanded']['outcome']} ({document['commanded']['unit']})")
            paths.append(save_figure(figure, figures / f"interpolation{label}_seed{seed}.png"))
    return paths


def _draw_pairs(axes: Axes, pairs: list[dict[str, Any]], document: dict[str, Any]) -> None:
    """Draws pairs side by side, from first to second task; as dots, since directions may pass from 360° to 0."""
    positions = 1 - np.array(document["betas"])
    names = [pair["between"][0] for pair in pairs] + [pairs[-1]["between"][1]]
    for row, pair in enumerate(pairs):
        dots, best, target = ("blend", "nearest to the target", "target") if row == 0 else ("", "", "")
        axes.plot(row + positions, pair["curve"], ".", color=COLOURS[0], markersize=3, label=dots)
        axes.plot(row + 1 - pair["beta"], pair["outcome"], "*", color=COLOURS[1], markersize=9, label=best, zorder=3)
        axes.hlines(pair["target"], row, row + 1, color="0.35", linestyle="--", label=target)
    axes.set_xticks(range(len(names)), names, rotation=90 if len(names) > 6 else 0)
    axes.set(xlim=(0, len(pairs)), xlabel="β from 1 to 0 between each task and the next")
    axes.legend(frameon=False, fontsize=7, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0))


def _draw_betas(axes: Axes, blends: list[dict[str, Any]], document: dict[str, Any]) -> None:
    """Draws one line per pair over the given β."""
    lines: dict[str, list[tuple[float, float]]] = {}
    for blend in blends:
        lines.setdefault(" – ".join(blend["between"]), []).append((blend["beta"], blend["outcome"]))
    for index, (name, points) in enumerate(lines.items()):
        axes.plot(*zip(*sorted(points), strict=True), **look(index), markersize=4, linewidth=1.4, label=name)
    axes.set(xlabel="β (1: the first task, 0: the second)")
    legend_below(axes, min(3, len(lines)))
