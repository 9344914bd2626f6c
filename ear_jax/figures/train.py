"""The figure that `ear train` draws of its run: returns, losses and the policy's spread, as curves over updates."""

from __future__ import annotations

from pathlib import Path

from ear_jax.figures.formats import write_figure
from ear_jax.figures.plot import axis_label, draw_band
from ear_jax.figures.style import styled, subplots
from ear_jax.runs.groups import Group, metric_names, read

# Shown if the method has them.
PANELS = ("mean_return", "entropy", "temperature", "critic_loss", "actor_loss", "q_value")


def draw_train(run: Path) -> list[Path]:
    """Draws a run's curves into its figures and returns their paths; nothing if they show its last row already.

    Raises:
      UsageError: there is no such run.
    """
    metrics, picture = run / "metrics.jsonl", run / "figures" / "training.png"
    if not metrics.exists() or (picture.exists() and picture.stat().st_mtime >= metrics.stat().st_mtime):
        return []
    members = Group("all seeds", (read(run),))
    shown = [metric for metric in PANELS if metric in metric_names(members.seeds[0])]
    with styled():
        rows = -(-len(shown) // 3)
        figure, grid = subplots(rows, min(3, len(shown)), figsize=(9, 2.5 * rows), layout="constrained", squeeze=False)
        for axes, metric in zip(grid.flat, shown, strict=False):
            draw_band(axes, members, metric, "updates", 0)
            axes.set(xlim=(0, None), title=axis_label(metric), xlabel="updates")
        for axes in grid.flat[len(shown) :]:
            axes.set_visible(False)
        seeds = len(members.seeds)
        figure.suptitle(f"{run.name}: mean and range of {seeds} seeds" if seeds > 1 else run.name)
        return write_figure(figure, picture)
