"""The paper's curves of training and of adaptation, drawn from our runs. Lines differ in more than colour."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from ear_jax.figures.style import COLOURS, legend_below, look, save_figure, styled, subplots
from ear_jax.files.replacing import folder
from experiments.report.run_index import Run

Lines = dict[str, list[Run]]  # runs by the label of their line; one without runs keeps its look for other panels
PANEL = (4.3, 3.3)  # inches


def draw_panels(path: Path, panels: Sequence[Callable[[Axes], None]]) -> Path:
    """Draws panels in a grid, at most two in a row."""
    columns = min(2, len(panels))
    rows = -(-len(panels) // columns)
    with styled():
        size = (PANEL[0] * columns, PANEL[1] * rows)
        figure, grid = subplots(rows, columns, figsize=size, layout="constrained", squeeze=False)
        for axes, draw in zip(grid.flat, panels, strict=False):
            draw(axes)
        for axes in grid.flat[len(panels) :]:
            axes.set_axis_off()
        folder(path.parent)
        return save_figure(figure, path)


def training_curves(axes: Axes, title: str, lines: Lines, reference: tuple[str, float] | None = None) -> None:
    """Draws mean return over tasks against env steps: a line for each method, mean ± standard deviation over seeds.

    Args:
      axes: the axes to draw on.
      title: the title.
      lines: the runs of each line.
      reference: label and height of a horizontal line to compare with.
    """
    for index, label, runs in _drawn(lines):
        _curve(axes, index, f"{label}, {len(runs)} seed{'s'[: len(runs) > 1]}", [_steps(run) for run in runs])
    if reference:
        axes.axhline(reference[1], color="0.35", linestyle=(0, (1, 2)), linewidth=1.2, label=reference[0])
    _finish(axes, title)


def task_curves(axes: Axes, title: str, run: Run) -> None:
    """Draws the return of each training task against env steps in one run."""
    for index, task in enumerate(run.last["returns"]):
        _curve(axes, index, task, [{row["env_steps"]: row["returns"][task] for row in run.rows}])
    _finish(axes, title, columns=5)


def _drawn(lines: Lines) -> list[tuple[int, str, list[Run]]]:
    """Returns index, label and runs of the lines that have runs."""
    return [(index, label, runs) for index, (label, runs) in enumerate(lines.items()) if runs]


def _steps(run: Run) -> dict[int, float]:
    return {row["env_steps"]: row["mean_return"] for row in run.rows}


def _curve(axes: Axes, index: int, label: str, curves: Sequence[dict[int, float]]) -> None:
    """Draws the mean of curves and their sample standard deviation, at the steps that all of them have."""
    shared = sorted(set.intersection(*map(set, curves)))
    values = np.array([[curve[step] for step in shared] for curve in curves])  # [seeds, steps]
    every = max(1, len(shared) // 8)
    axes.plot(shared, values.mean(0), **look(index), markersize=4, markevery=every, linewidth=1.4, label=label)
    if len(curves) > 1:
        middle, width = values.mean(0), values.std(0, ddof=1)
        axes.fill_between(shared, middle - width, middle + width, color=look(index)["color"], alpha=0.15, linewidth=0)


def _finish(axes: Axes, title: str, columns: int = 2) -> None:
    axes.set(xlim=(0, None), xlabel="env steps, all tasks together", ylabel="return of an episode", title=title)
    axes.xaxis.set_major_formatter(FuncFormatter(_short))
    legend_below(axes, columns)


def _short(steps: float, _: int) -> str:
    """Formats env steps on an axis, as in 400k and 1.2M."""
    if steps >= 1e6:
        return f"{steps / 1e6:g}M"
    return f"{steps / 1e3:g}k" if steps else "0"


def adaptation_curves(axes: Axes, title: str, lines: Lines) -> None:
    """Draws mean return on unseen tasks against env steps a task: of the LTE found, and of the search's episodes."""
    for index, label, runs in _drawn(lines):
        style = look(index)
        searched = [task for run in runs for task in run.of_seed("adaptation", "tasks") if task["epochs"]]
        epochs = min(len(task["epochs"]) for task in searched)
        played, mapped = (
            float(np.mean([_steps_a_task(run, key) for run in runs])) for key in ("env_steps", "map_env_steps")
        )
        for name, what, line in (("reevaluated", "fresh episodes", "-"), ("best_of_epoch", "search episodes", "--")):
            mean = np.mean([[epoch[name] for epoch in task["epochs"][:epochs]] for task in searched], axis=0)
            look_of = {**style, "linestyle": line, "fillstyle": "full" if line == "-" else "none"}
            steps = played / epochs * np.arange(1, len(mean) + 1)
            axes.plot(steps, mean, **look_of, markersize=4, label=f"{label}: {what}")
        answers = [task["zero_shot"]["reevaluated"] for task in searched if task.get("zero_shot")]
        if len(answers) == len(searched):
            axes.plot(mapped, np.mean(answers), "*", color=style["color"], markersize=9, label=f"{label}: from a map")
    axes.set(xscale="log", xlabel="env steps a task", ylabel="return, mean over unseen tasks", title=title)
    axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.xaxis.set_major_formatter(FuncFormatter(_short))
    axes.xaxis.set_minor_formatter(NullFormatter())
    legend_below(axes, 2)


def _steps_a_task(run: Run, key: str) -> float:
    """Returns the env steps that adaptation played for each task. The steps of the map are shared by all tasks."""
    document = run.document("adaptation") or {}
    return document.get(key, 0) / len(document["tasks"])


def returns_beside(axes: Axes, title: str, rows: Sequence[tuple[str, list[float], dict[str, float] | None]]) -> None:
    """Draws a row for each method: our seeds and their mean, and below them the paper's mean and standard deviation.

    Args:
      axes: the axes to draw on.
      title: the title.
      rows: for each method its name, the returns of our seeds and `mean` and `std` of the paper, if it has them.
    """
    for place, (_, ours, paper) in enumerate(rows):
        dot = {"color": COLOURS[0], "marker": "o", "linestyle": "none", "markersize": 5}
        axes.plot(ours, [place - 0.12] * len(ours), **dot, fillstyle="none")
        axes.plot([np.mean(ours)] if ours else [], [place - 0.12][: len(ours)], **dot)
        if paper:
            bar = {"color": COLOURS[1], "fmt": "D", "markersize": 4, "capsize": 2}
            axes.errorbar(paper["mean"], place + 0.16, xerr=paper["std"], **bar)
    axes.set_yticks(range(len(rows)), [name for name, *_ in rows])
    axes.set(xlabel="return of an episode", title=title, ylim=(len(rows) - 0.5, -0.5))
