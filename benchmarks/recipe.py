"""Draws and tabulates the trials behind the `fast` preset for `docs/trials.md`, from `results/recipe.jsonl` alone.

A row is one trial: what differed from the first, the trial it is held against, and its curve as [updates, env steps,
seconds, mean return], of one seed or averaged over several.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from benchmarks.common import RESULTS
from ear_jax.figures.style import COLOURS, save_figure, styled, subplots
from ear_jax.runs import records
from experiments.report import documents
from experiments.report.blocks import Table
from experiments.report.formatting import MISSING, NAMES, count, number
from experiments.report.markdown import table

DOCUMENT = RESULTS.parent.parent / "docs" / "trials.md"
PLACE = "trials"
PICTURE = DOCUMENT.parent / "images" / "recipe.png"
COLUMNS = ("trial", "family", "held against", "updates", "return", "return of the other")
LONG = 68_000  # updates
NAMED = 5  # trials in colour


def draw(axes: Axes, rows: list[dict[str, Any]]) -> None:
    """Draws return against updates, the median of five evaluations: some trials in colour, the others in grey."""
    shown = named(rows)
    for row in rows:
        updates, _, _, returns = np.array(row["curve"]).T
        style = {"color": "0.75", "linewidth": 0.8}
        if row in shown:
            style = {"color": COLOURS[shown.index(row)], "label": row["trial"], "zorder": 3}
        axes.plot(updates / 1000, _median_of_five(returns), **style)
    if len(shown) < len(rows):
        axes.plot([], [], color="0.75", linewidth=0.8, label="others")
    axes.set(xlabel="updates (thousands)", ylabel="return, mean over tasks", ylim=_upper(rows))
    axes.set_title(NAMES[rows[0]["family"]])
    axes.legend(fontsize=7, frameon=False, loc="upper left", bbox_to_anchor=(1.01, 1.0))


def named(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Returns the first of a family's long trials, and those of them with the highest returns after `LONG` updates."""

    def height(row: dict[str, Any]) -> float:
        updates, _, _, returns = np.array(row["curve"]).T
        return float(np.interp(LONG, updates, returns, left=-np.inf))

    first, *others = [row for row in rows if row["curve"][-1][0] >= LONG]
    best = sorted(others, key=height, reverse=True)[: NAMED - 1]
    return [first, *(row for row in others if row in best)]


def _median_of_five(values: np.ndarray) -> np.ndarray:
    """Returns the median of each value and its two neighbours on either side; fewer at the ends."""
    return np.array([np.median(values[max(0, index - 2) : index + 3]) for index in range(len(values))])


def _upper(rows: list[dict[str, Any]]) -> tuple[float, float]:
    """Returns the limits of the y axis. They leave out low returns, where all trials look alike."""
    first = float(np.median([row["curve"][0][3] for row in rows]))
    best = max(point[3] for row in rows for point in row["curve"])
    return first + 0.35 * (best - first), best + 0.03 * (best - first)


def trials(rows: list[dict[str, Any]]) -> str:
    """Returns the table of trials: the returns of a trial and of the one beside it, at the end of the shorter."""
    curves = {(row["family"], row["trial"]): {point[0]: point[3] for point in row["curve"]} for row in rows}
    lines = []
    for row in rows:
        curve, other = curves[row["family"], row["trial"]], curves.get((row["family"], row["beside"]), {})
        updates = max(set(curve) & set(other or curve))
        theirs = number(other[updates], 0) if other else MISSING
        beside = row["beside"] or MISSING
        lines.append([row["trial"], NAMES[row["family"]], beside, count(updates), number(curve[updates], 0), theirs])
    return table(Table("", COLUMNS, lines))


def main(picture: Path = PICTURE) -> None:
    rows = records.read_rows(RESULTS / "recipe.jsonl")
    documents.put(DOCUMENT, PLACE, trials(rows))
    families = list(dict.fromkeys(row["family"] for row in rows))
    with styled():
        size = (9.6, 3.4 * len(families))
        figure, grid = subplots(len(families), figsize=size, layout="constrained", squeeze=False)
        for axes, family in zip(grid.flat, families, strict=True):
            draw(axes, [row for row in rows if row["family"] == family])
        save_figure(figure, picture)
    print(picture)


if __name__ == "__main__":
    main()
