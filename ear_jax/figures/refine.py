"""The figure of `ear refine`: the return of each task before and after, and of the schedules in between."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np

from ear_jax.errors import plain
from ear_jax.figures.style import STYLE, look, save_figure
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
    before, places = np.array(entry["returns"]), np.arange(len(entry["returns"]))
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(figsize=(5.0, 3.0), layout="constrained")
        axes.axhline(0, color="0.7", linewidth=0.8)
        for number, found in enumerate(entry["rounds"], 1):
            colour = look(number - 1)["color"]
            gains = [np.array(found[name]) - before for name in ("returns_scheduled", "returns_refined")]
            axes.plot(places, gains[0], "x", markersize=5, color=colour, label=f"round {number}: schedules")
            axes.plot(places, gains[1], "o-", markersize=3, color=colour, label=f"round {number}: refined policy")
        axes.set_xticks(places, [plain(name) for name in entry["tasks"]], rotation=60, ha="right", fontsize=6)
        axes.set_ylabel("gain of return")
        last = entry["rounds"][-1]["refined"]
        axes.set_title(f"mean return {entry['mean_return']:.1f} before, {last:.1f} after", fontsize=8)
        axes.legend(fontsize=6)
        return save_figure(figure, path)
