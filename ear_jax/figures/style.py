"""The style of all figures: colours, lines and legends."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
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
}


def look(index: int) -> dict[str, Any]:
    """Returns colour, line style and marker of the line of an index; the first twelve all differ."""
    return {
        "color": COLOURS[index % len(COLOURS)],
        "linestyle": LINES[(index + index // len(COLOURS)) % len(LINES)],
        "marker": MARKERS[(index + index // len(COLOURS)) % len(MARKERS)],
    }


def save_figure(figure: Figure, path: Path, **options: Any) -> Path:
    """Writes a figure, as PNG unless `format` is given, and closes it; returns the path.

    Args:
      figure: a figure of pyplot.
      path: the file, which is replaced.
      options: further options of `Figure.savefig`.

    Raises:
      RunError: the file cannot be written.
    """
    try:
        with replace_file(path) as scratch:
            figure.savefig(scratch, **{"format": "png", **options})
    finally:
        plt.close(figure)
    return path


def legend_below(axes: Axes, columns: int) -> None:
    """Puts the legend below the axes, where it hides no line."""
    axes.legend(fontsize=7, ncols=columns, frameon=False, loc="upper center", bbox_to_anchor=(0.5, -0.2))
