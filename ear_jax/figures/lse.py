"""The figure of `ear lse`: the raw state and the latent sensory embedding along one gait, side by side."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from ear_jax.figures.style import COLOURS, save_figure, styled, subplots
from ear_jax.files.replacing import folder

NAMES = {"state": "raw state", "lse": "LSE"}


def draw_lse(figures: Path, document: dict[str, Any], label: str = "") -> list[Path]:
    """Draws one figure per seed, principal components and autocorrelations, and returns the paths.

    Args:
      figures: the folder to write into.
      document: the document of `ear lse`.
      label: a part of the names of the files.
    """
    folder(figures)
    return [_draw_seed(figures / f"lse{label}_seed{entry['seed']}.png", entry, document) for entry in document["seeds"]]


def _draw_seed(path: Path, entry: dict[str, Any], document: dict[str, Any]) -> Path:
    with styled():
        figure, (first, second, third) = subplots(1, 3, figsize=(9.5, 2.9), layout="constrained")
        _draw_path(first, entry["state"], NAMES["state"], document["dt"])
        points = _draw_path(second, entry["lse"], NAMES["lse"], document["dt"])
        bar = figure.colorbar(points, ax=second, shrink=0.9)
        bar.set_label("time (s)")
        for index, name in enumerate(NAMES):
            signal = entry[name]
            lags = document["dt"] * np.arange(len(signal["autocorrelation"]))
            third.plot(lags, signal["autocorrelation"], color=COLOURS[index], label=NAMES[name], ls=("-", "--")[index])
            if signal["period"]:
                third.plot(signal["period"], signal["autocorrelation_peak"], "o", color=COLOURS[index], markersize=5)
        third.set(xlabel="lag (s)", ylabel="autocorrelation", ylim=(-1.05, 1.05), title=f"task {document['task']}")
        third.legend(frameon=False, loc="lower right")
        return save_figure(figure, path)


def _draw_path(axes: Axes, signal: dict[str, Any], name: str, dt: float) -> Any:
    x, y = np.array(signal["path"]).T
    axes.plot(x, y, color="0.8", linewidth=0.8, zorder=1)
    points = axes.scatter(x, y, c=dt * np.arange(len(x)), cmap="viridis", s=9, zorder=2)
    share = f"{sum(signal['explained']):.0%} of the variance"
    axes.set(xlabel="1st principal component", ylabel="2nd principal component", title=f"{name}: {share}")
    return points
