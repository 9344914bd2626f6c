"""The figure of `ear imagine`: the loss, and the outcomes imagined under the training tasks' LTEs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ear_jax.figures.style import look, save_figure, styled, subplots
from ear_jax.files.replacing import folder


def draw_imagine(figures: Path, document: dict[str, Any], label: str = "") -> list[Path]:
    """Draws one figure per seed and returns the paths.

    Args:
      figures: the folder to write into.
      document: the document of `ear imagine`.
      label: a part of the names of the files.
    """
    folder(figures)
    return [
        _draw(figures / f"imagination{label}_seed{entry['seed']}.png", entry, document) for entry in document["seeds"]
    ]


def _draw(path: Path, entry: dict[str, Any], document: dict[str, Any]) -> Path:
    names = list(entry["trained"][0]["imagined"])
    with styled():
        size = (3.4 * (1 + len(names)), 3.0)
        figure, (loss, *outcomes) = subplots(1, 1 + len(names), figsize=size, layout="constrained")
        loss.plot(np.linspace(0, document["updates"], len(entry["loss"])), entry["loss"], color=look(0)["color"])
        loss.set(xlabel="updates", ylabel="cross-entropy")
        tasks = [task["name"] for task in entry["trained"]]
        for index, (axes, name) in enumerate(zip(outcomes, names, strict=True)):
            values = [task["imagined"][name] for task in entry["trained"]]
            axes.plot(range(len(tasks)), values, **{**look(index), "linestyle": "none"}, markersize=4)
            axes.set_xticks(range(len(tasks)), tasks, rotation=90, fontsize=7)
            axes.set(title=f"{name}, imagined")
        return save_figure(figure, path)
