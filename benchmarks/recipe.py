"""Draws `docs/images/recipe.png`: the trials behind the `fast` preset, from `results/recipe.jsonl` alone.

A row is one trial: what differed from the first, and its curve as [updates, env steps, seconds, mean return].
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from benchmarks.common import RESULTS
from ear_jax import records
from ear_jax.report.figures import COLOURS, STYLE

PICTURE = RESULTS.parent.parent / "docs" / "images" / "recipe.png"
LINES = ("-", "--", ":", "-.")


def draw(axes: Axes, rows: list[dict[str, Any]]) -> None:
    """Return against updates, a line a trial."""
    for index, row in enumerate(rows):
        updates, _, _, returns = np.array(row["curve"]).T
        style = {"color": COLOURS[index % len(COLOURS)], "linestyle": LINES[index % len(LINES)]}
        axes.plot(updates / 1000, returns, label=row["trial"], **style)
    axes.set(xlabel="updates (thousands)", ylabel="return, mean over tasks", title=rows[0]["family"], xlim=(0, 30))
    axes.legend(frameon=False, fontsize=7)


def main(picture: Path = PICTURE) -> None:
    rows = records.read_rows(RESULTS / "recipe.jsonl")
    families = list(dict.fromkeys(row["family"] for row in rows))
    with plt.rc_context(STYLE):
        figure, grid = plt.subplots(1, len(families), figsize=(3.6 * len(families), 3.2), layout="constrained")
        for axes, family in zip(np.atleast_1d(grid), families, strict=True):
            draw(axes, [row for row in rows if row["family"] == family])
        figure.savefig(picture)
    print(picture)


if __name__ == "__main__":
    main()
