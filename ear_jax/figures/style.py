"""The style of all figures: colours, lines and legends."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ear_jax.files.replacing import replace_file

# Okabe and Ito's palette, which colour-blind readers can distinguish.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
LINES = ("-", "--", "-.", ":")
MARKERS = "os^Dvx"
STYLE: Any = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "figure.dpi": 160,
    "savefig.bbox": "tight",
    "text.parse_math": False,  # a name with dollar signs is a name
    "svg.hashsalt": "ear_jax",  # with no date either, equal figures give equal files
}
_drawing = threading.RLock()


@contextlib.contextmanager
def styled(changes: Mapping[str, Any] | None = None) -> Iterator[None]:
    """A context in which figures have the style; one thread draws at a time, as Matplotlib's settings are global."""
    settings: Any = {**STYLE, **(changes or {})}
    with _drawing, matplotlib.rc_context(settings):
        yield


def subplots(*shape: int, figsize: tuple[float, float], layout: Any = None, **options: Any) -> tuple[Figure, Any]:
    """Returns a figure and its axes as pyplot does, which would also choose a backend and keep the figure open.

    Args:
      shape: rows and columns; one of each by default.
      figsize: width and height in inches.
      layout: of `Figure`.
      options: further options of `Figure.subplots`.
    """
    figure = Figure(figsize=figsize, layout=layout)
    return figure, figure.subplots(*shape, **options)


def look(index: int) -> dict[str, Any]:
    """Returns colour, line style and marker of the line of an index; the first twelve all differ."""
    return {
        "color": COLOURS[index % len(COLOURS)],
        "linestyle": LINES[(index + index // len(COLOURS)) % len(LINES)],
        "marker": MARKERS[(index + index // len(COLOURS)) % len(MARKERS)],
    }


def save_figure(figure: Figure, path: Path, **options: Any) -> Path:
    """Writes a figure, as PNG unless `format` is given, and returns the path.

    Args:
      figure: a figure.
      path: the file, which is replaced.
      options: further options of `Figure.savefig`.

    Raises:
      RunError: the file cannot be written.
    """
    with replace_file(path) as scratch:
        figure.savefig(scratch, **{"format": "png", **options})
    return path


def legend_below(axes: Axes, columns: int) -> None:
    """Puts the legend below the axes, where it hides no line."""
    axes.legend(fontsize=7, ncols=columns, frameon=False, loc="upper center", bbox_to_anchor=(0.5, -0.2))
