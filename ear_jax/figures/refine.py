"""The figure of `ear refine`: its course, and the return of each task before and after."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ear_jax.errors import plain
from ear_jax.figures.style import look, save_figure, styled, subplots
from ear_jax.files.replacing import folder


def draw_refine(figures: Path, document: dict[str, Any], label: str = "") -> list[Path]:
    """Draws one figure per seed and returns the paths.

    Args:
      figures: the folder to write into.
      document: the document of `ear refine`.
      label: a part of the names of the files.
    """
    folder(figures)
    return [_draw(figures / f"refinement{label}_seed{entry['seed']}.png", entry) for entry in document["seeds"]]


def _draw(path: Path, entry: dict[str, Any]) -> Path:
    gain = np.array(entry["returns_after"]) - np.array(entry["returns_before"])
    places = np.arange(len(gain))
    with styled():
        figure, (left, right) = subplots(1, 2, figsize=(8.0, 3.0), layout="constrained")
        left.plot(np.arange(1, len(entry["course"]) + 1), entry["course"], color=look(0)["color"], linewidth=0.8)
        left.set_xlabel("iteration")
        left.set_ylabel("mean return, with noise")
        right.axhline(0, color="0.7", linewidth=0.8)
        right.bar(places, gain, color=look(0)["color"])
        right.set_xticks(places, [plain(name) for name in entry["tasks"]], rotation=60, ha="right", fontsize=6)
        right.set_ylabel("gain of return, without noise")
        figure.suptitle(f"mean return {entry['before']:.1f} before, {entry['after']:.1f} after", fontsize=8)
        return save_figure(figure, path)
