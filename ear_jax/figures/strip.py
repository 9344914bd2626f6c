"""Stop-motion strips: poses of the robot at equal times, with a flag at its last position."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from ear_jax.figures.style import save_figure, styled

FLAG, GROUND = "#D5000F", "#CED2CE"
LEFT, RIGHT, BELOW, ABOVE = 1.1, 0.15, 0.45, 0.5  # inches around the panels
WIDEST, TALLEST = 5.8, 5.0  # largest size of a panel, inches
DPI = 200


@dataclass(frozen=True)
class Track:
    """One robot's poses as stick figures, in metres across the panel and up."""

    label: str
    colours: np.ndarray  # [poses, 3] in [0, 1]
    limbs: np.ndarray  # [poses, limbs, 2, 2]
    radii: np.ndarray  # [limbs] metres
    flag: tuple[float, float, float] | None  # x and foot of the flag and length of its pole; None for a fixed robot


@dataclass(frozen=True)
class Panel:
    """Tracks on one ground, and their rendered picture if there is one."""

    tracks: Sequence[Track]
    picture: np.ndarray | None = None


@dataclass(frozen=True)
class Bounds:
    """The part of the plane that every panel of a strip shows, in metres."""

    left: float
    right: float
    low: float
    high: float
    ground: float  # upper edge of the ground
    tallest: float = TALLEST  # largest height of the panel, inches

    @property
    def inches(self) -> tuple[float, float]:
        """The size of a panel in inches, to scale."""
        wide, tall = self.right - self.left, self.high - self.low
        scale = min(WIDEST / wide, self.tallest / tall)
        return wide * scale, tall * scale

    @property
    def pixels(self) -> tuple[int, int]:
        """The size in pixels of a picture that fills a panel."""
        width, height = self.inches
        return round(width * DPI), round(height * DPI)


def draw_strip(path: Path, panels: Sequence[Panel], bounds: Bounds, caption: str, beside: bool = False) -> Path:
    """Draws panels one below another or side by side: their pictures, or stick figures for panels without one.

    Args:
      path: the file to write.
      panels: the panels; the labels of their tracks are at the left, or above panels that stand side by side, in the
        tracks' colours if a panel has several.
      bounds: the part of the plane that each panel shows.
      caption: the text below the axis.
      beside: put the panels side by side.
    """
    (width, height), gap, count = bounds.inches, 0.06, len(panels)
    wide, tall = LEFT + width + RIGHT, BELOW + count * (height + gap)
    if beside:
        wide, tall = 2 * RIGHT + count * (width + gap), BELOW + height + ABOVE
    with styled({"axes.grid": False, "savefig.bbox": None}):
        figure = Figure(figsize=(wide, tall))
        for row, panel in enumerate(panels):
            left, bottom = (RIGHT + row * (width + gap), BELOW) if beside else (LEFT, tall - (row + 1) * (height + gap))
            axes = figure.add_axes((left / wide, bottom / tall, width / wide, height / tall))
            _draw_panel(axes, panel, bounds, beside)
            shown = beside or row == count - 1
            axes.tick_params(bottom=shown, labelbottom=shown)
        middle = wide / 2 if beside else LEFT + width / 2
        figure.text(middle / wide, 0.05 / tall, caption, ha="center", va="bottom")
        return save_figure(figure, path, dpi=DPI)


def _draw_panel(axes: Axes, panel: Panel, bounds: Bounds, beside: bool) -> None:
    inch = (bounds.right - bounds.left) / bounds.inches[0]  # metres in an inch
    axes.set(xlim=(bounds.left, bounds.right), ylim=(bounds.low, bounds.high), yticks=[])
    axes.spines[:].set_visible(False)
    if panel.picture is not None:
        axes.imshow(panel.picture, extent=(bounds.left, bounds.right, bounds.low, bounds.high), aspect="auto")
    else:
        axes.axhspan(bounds.low, bounds.ground, color=GROUND)
    for row, track in enumerate(panel.tracks):
        if panel.picture is None:
            _draw_sticks(axes, track, 72 / inch)
        if track.flag:
            _draw_flag(axes, *track.flag, inch)
        colour = "black" if len(panel.tracks) == 1 else track.colours[-1]
        position = (0.5, 1.0) if beside else (-0.02, 1 - (row + 0.5) / len(panel.tracks))
        across, along = ("center", "bottom") if beside else ("right", "center")
        axes.text(*position, track.label, transform=axes.transAxes, color=colour, ha=across, va=along)


def _draw_sticks(axes: Axes, track: Track, points: float) -> None:
    """Draws every limb as a line of the limb's thickness; `points` is the number of points in a metre."""
    for limbs, colour in zip(track.limbs, track.colours, strict=True):
        widths = 2 * points * track.radii
        axes.add_collection(LineCollection(list(limbs), linewidths=widths, colors=[colour], capstyle="round"))


def _draw_flag(axes: Axes, x: float, foot: float, pole: float, inch: float) -> None:
    """Draws a red flag whose pole starts at `foot`; lengths in metres, with `inch` metres in an inch."""
    top = foot + pole
    axes.plot((x, x), (foot, top), color=FLAG, linewidth=1.2)
    cloth = [(x, top), (x + 0.16 * inch, top - 0.055 * inch), (x, top - 0.11 * inch)]
    axes.add_patch(Polygon(cloth, color=FLAG, linewidth=0))
