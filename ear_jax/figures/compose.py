"""The figure of `ear compose`: outcomes along β, and the ground contacts of the feet over time."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from ear_jax.figures.style import COLOURS, save_figure, styled, subplots
from ear_jax.files.replacing import folder

UNITS = {"height": "m", "squared_action": "1", "velocity_x": "m/s", "velocity_y": "m/s"}


def draw_compose(figures: Path, document: dict[str, Any], label: str = "") -> list[Path]:
    """Draws one figure per seed and returns the paths.

    Args:
      figures: the folder to write into.
      document: the document of `ear compose`.
      label: a part of the names of the files.
    """
    folder(figures)
    label = label or "_" + "_to_".join(document["between"])
    return [
        _draw_seed(figures / f"compose{label}_seed{entry['seed']}.png", entry["blends"], document)
        for entry in document["seeds"]
    ]


def _draw_seed(path: Path, blends: list[dict[str, Any]], document: dict[str, Any]) -> Path:
    quantity = document["commanded"]
    names = [name for name in blends[0]["outcome"] if name != "squared_action"]
    columns = len(names) + bool(document["feet"])
    with styled():
        figure, grid = subplots(1, columns, figsize=(3.2 * columns, 2.9), layout="constrained", squeeze=False)
        for axes, name in zip(grid[0], names, strict=False):
            unit = quantity["unit"] if name == quantity["outcome"] else UNITS.get(name, "")
            values = [blend["outcome"][name] for blend in blends]
            axes.plot([blend["beta"] for blend in blends], values, marker="o", markersize=4, color=COLOURS[0])
            axes.set(xlabel=_beta_label(document), ylabel=f"{name} ({unit})")
        if document["feet"]:
            _draw_contacts(grid[0, -1], blends, document)
        return save_figure(figure, path)


def _draw_contacts(axes: Axes, blends: list[dict[str, Any]], document: dict[str, Any]) -> None:
    """Draws one line per blend and foot, interrupted while that foot is off the ground."""
    dt, feet = document["dt"], document["feet"]
    for row, blend in enumerate(blends):
        down = np.array(blend["pattern"], bool)
        time = dt * np.arange(len(down))
        for column, foot in enumerate(feet):
            height = row + 0.25 * (column - (len(feet) - 1) / 2)
            label = f"{foot} foot" if row == 0 else None
            spans = [(start, dt) for start, touches in zip(time, down[:, column], strict=True) if touches]
            axes.broken_barh(spans, (height - 0.1, 0.2), color=COLOURS[column], label=label, linewidth=0)
    axes.set_yticks(range(len(blends)), [f"{blend['beta']:g}" for blend in blends])
    axes.invert_yaxis()
    axes.set(xlabel="time (s)", ylabel="β", title="feet on the ground")
    axes.grid(visible=False)
    axes.legend(frameon=False, ncols=len(feet), loc="upper center", bbox_to_anchor=(0.5, -0.22), fontsize=7)


def _beta_label(document: dict[str, Any]) -> str:
    return f"β (0: {document['between'][1]}, 1: {document['between'][0]})"
