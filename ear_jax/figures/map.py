"""The figures of `ear map`: the LTE sphere, coloured by what the robot achieves under each LTE."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Colormap, Normalize
from matplotlib.figure import Figure

from ear_jax.figures.style import save_figure, styled
from ear_jax.files.replacing import folder

VIEWS = ((20.0, 30.0), (-20.0, 210.0))  # elevation and azimuth of two opposite sides of the sphere, degrees
BEHIND = {"boxstyle": "round,pad=0.1", "facecolor": "white", "alpha": 0.7, "linewidth": 0}  # box behind a label


def draw_map(figures: Path, document: dict[str, Any], label: str = "") -> list[Path]:
    """Draws for every seed both sides of the sphere and a flat map of it, and returns the paths.

    Args:
      figures: the folder to write into.
      document: the document of `ear map`.
      label: a part of the names of the files.
    """
    folder(figures)
    return [
        path
        for entry in document["seeds"]
        for path in (
            _draw_sphere(figures / f"sphere{label}_seed{entry['seed']}.png", entry, document["commanded"]),
            _draw_flat(figures / f"map{label}_seed{entry['seed']}.png", entry, document["commanded"]),
        )
    ]


def colours(achieved: list[float], commanded: dict[str, Any]) -> tuple[Colormap, Normalize]:
    """Returns the colour map and its scale: a cyclic one for a quantity that wraps, else from the least to the most."""
    if commanded["period"] is not None:
        return matplotlib.colormaps["twilight"], Normalize(0, commanded["period"])
    return matplotlib.colormaps["viridis"], Normalize(min(achieved), max(achieved))


def _draw_sphere(path: Path, entry: dict[str, Any], commanded: dict[str, Any]) -> Path:
    shades, scale = colours(entry["achieved"], commanded)
    ltes, trained = np.array(entry["ltes"]), np.array([task["lte"] for task in entry["trained"]])
    with styled():
        figure = Figure(figsize=(7.0, 3.4))
        for index, (elevation, azimuth) in enumerate(VIEWS):
            # Without perspective a view shows exactly half of the sphere.
            axes: Any = figure.add_subplot(1, 2, index + 1, projection="3d", proj_type="ortho", computed_zorder=False)
            toward = direction_of(elevation, azimuth)
            labels = trained + 0.17 * _across(trained, toward)
            near, shown = faces(ltes, index), faces(trained, index)
            reached = np.array(entry["achieved"])[near]
            axes.scatter(*ltes[near].T, c=reached, cmap=shades, norm=scale, s=14, depthshade=False)
            for task, code, label in zip(np.array(entry["trained"])[shown], trained[shown], labels[shown], strict=True):
                axes.scatter(*(1.03 * code), color="white", edgecolor="black", s=26, zorder=4, depthshade=False)
                axes.text(*label, _label(task), ha="center", va="center", fontsize=7, bbox=BEHIND, zorder=3)
            axes.view_init(elevation, azimuth)
            axes.set_box_aspect((1, 1, 1), zoom=1.45)
            axes.set_axis_off()
        bar = figure.colorbar(ScalarMappable(scale, shades), ax=figure.axes, shrink=0.75, pad=0.02)
        bar.set_label(f"{commanded['outcome']} ({commanded['unit']})")
        return save_figure(figure, path)


def direction_of(elevation: float, azimuth: float) -> np.ndarray:
    """Returns the unit vector [3] from the sphere's centre to the viewer, of angles in degrees."""
    up, turn = np.radians((elevation, azimuth))
    return np.array([np.cos(up) * np.cos(turn), np.cos(up) * np.sin(turn), np.sin(up)])


def faces(codes: np.ndarray, view: int) -> np.ndarray:
    """Returns which of some codes [n, 3] a view of `VIEWS` shows, bool [n]; each code is in exactly one of the two."""
    first = codes @ direction_of(*VIEWS[0]) >= 0
    return ~first if view else first


def _across(codes: np.ndarray, toward: np.ndarray) -> np.ndarray:
    """Returns unit vectors [n, 3] that lead from codes [n, 3] to their labels, across the line of codes in a view."""
    sideways = np.cross(toward, np.diff(codes, axis=0, append=codes[:1]))
    return sideways / np.maximum(np.linalg.norm(sideways, axis=1, keepdims=True), 1e-9)


def _draw_flat(path: Path, entry: dict[str, Any], commanded: dict[str, Any]) -> Path:
    shades, scale = colours(entry["achieved"], commanded)
    with styled():
        figure = Figure(figsize=(6.2, 3.2))
        axes: Axes = figure.add_subplot(projection="mollweide")
        longitude, latitude = _angles(np.array(entry["ltes"]))
        points = axes.scatter(longitude, latitude, c=entry["achieved"], cmap=shades, norm=scale, s=12, linewidths=0)
        for task in entry["trained"]:
            position = _angles(np.array([task["lte"]]))
            axes.scatter(*position, color="white", edgecolor="black", s=28, zorder=4, clip_on=False)
            axes.annotate(
                _label(task),
                (position[0][0], position[1][0]),
                xytext=(6, 0),
                textcoords="offset points",
                va="center",
                fontsize=7,
                bbox=BEHIND,
                zorder=3,
            )
        axes.set(xticklabels=[], yticklabels=[], xlabel="LTE sphere, equal areas; circles: LTEs of the training tasks")
        axes.grid(alpha=0.3)
        bar = figure.colorbar(points, ax=axes, shrink=0.85, pad=0.03)
        bar.set_label(f"{commanded['outcome']} ({commanded['unit']})")
        return save_figure(figure, path)


def _angles(codes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the longitude and latitude, in radians, of unit vectors [n, 3]."""
    return np.arctan2(codes[:, 1], codes[:, 0]), np.arcsin(np.clip(codes[:, 2], -1, 1))


def _label(task: dict[str, Any]) -> str:
    return task["name"] if task["target"] is None else f"{task['target']:g}"
