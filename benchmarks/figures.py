"""Draws `results/benchmarks.png` from the JSON lines in `results/`; the last row of each setting counts."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator

from benchmarks import common
from ear_jax.cli.exits import exit_code
from ear_jax.errors import RunError
from ear_jax.figures.style import COLOURS, legend_below, save_figure, styled, subplots
from ear_jax.runs import records

Row = dict[str, Any]
ENGINES = ("raw", "native", "mjx", "gymnasium-async", "gymnasium-sync", "spring", "warp")
COLOUR = dict(zip(ENGINES, (*COLOURS, "0.4"), strict=True))
TARGET = 0.95  # fraction of raw speed, for the native engine


def latest(path: Path, keys: tuple[str, ...]) -> list[Row]:
    """Returns the last row of each setting, identified by `keys`; quick rows only if there are no others."""
    rows = [row for row in records.read_rows(path) if "unavailable" not in row]
    rows = [row for row in rows if not row["quick"]] or rows
    return list({tuple(row.get(key) for key in keys): row for row in rows}.values())


def bars(axes: Axes, groups: list[str], series: list[tuple[str, str, list[Row | None]]], figure: str) -> None:
    """Draws grouped bars of medians, each with the range of its runs.

    Args:
      axes: the axes to draw on.
      groups: names along the x axis.
      series: label, colour, and a row or None for each group.
      figure: the key of the median; `_min` and `_max` are appended for the range.
    """
    width = 0.8 / max(1, len(series))
    for index, (label, colour, rows) in enumerate(series):
        present = [(group, row) for group, row in enumerate(rows) if row]
        x = [group + (index - (len(series) - 1) / 2) * width for group, _ in present]
        middle, low, high = (
            np.array([row[key] for _, row in present]) for key in (figure, f"{figure}_min", f"{figure}_max")
        )
        errors = np.stack([middle - low, high - middle])
        style = {"ecolor": "0.2", "elinewidth": 0.8}
        axes.bar(x, middle, width, color=colour, label=label, yerr=errors, error_kw=style, zorder=2)
    axes.set_xticks(range(len(groups)), groups)
    axes.grid(axis="x", visible=False)


def draw_physics(axes: Axes, rows: list[Row]) -> None:
    """Draws env steps per second by family; each engine has a colour and its largest batch."""
    families = list(dict.fromkeys(row["family"] for row in rows))
    series = []
    for engine in ENGINES:
        # Raw runs are paired with every engine; those paired with the native engine are shown.
        measured = [row for row in rows if row["engine"] == engine and row.get("beside") in (None, engine, "native")]
        if measured:
            batch = max(row["batch"] for row in measured)
            by_family = {row["family"]: row for row in measured if row["batch"] == batch}
            series.append((f"{engine}, {batch}", COLOUR[engine], [by_family.get(family) for family in families]))
    bars(axes, [_lines(family) for family in families], series, "env_steps_per_second")
    axes.set(ylabel="env steps per second", title="Physics, by engine and batch")
    _log_scale(axes)
    legend_below(axes, 3)


def draw_ratios(axes: Axes, rows: list[Row]) -> None:
    """Draws the native engine's speed as a fraction of raw `mujoco.batch`'s, by batch."""
    native = [row for row in rows if row["engine"] == "native"]
    families, batches = (list(dict.fromkeys(row[key] for row in native)) for key in ("family", "batch"))
    find = {(row["family"], row["batch"]): row for row in native}
    series = [
        (f"batch {batch}", COLOURS[index], [find.get((family, batch)) for family in families])
        for index, batch in enumerate(batches)
    ]
    bars(axes, [_lines(family) for family in families], series, "ratio_to_raw")
    axes.axhline(TARGET, color="0.2", linewidth=1, linestyle="--", label=f"target, {TARGET}")
    axes.set(ylabel="speed / speed of raw mujoco.batch", title="Native engine inside jit, scan and vmap")
    legend_below(axes, 4)


def draw_updates(axes: Axes, rows: list[Row]) -> None:
    """Draws the time of an update and of its matmuls, with their ratio."""
    groups = [f"{row['preset']}\n{row['seeds']} seed{'s' * (row['seeds'] > 1)}" for row in rows]
    parts = (("whole update", COLOURS[0], "update_ms"), ("its matmuls alone", COLOURS[1], "matmuls_ms"))
    renamed = [(label, colour, [_rename(row, key) for row in rows]) for label, colour, key in parts]
    bars(axes, groups, renamed, "ms")
    for group, row in enumerate(rows):
        top = max(row["update_ms_max"], row["matmuls_ms_max"])
        axes.annotate(f"× {row['ratio_to_matmuls']:.2f}", (group, top * 1.15), ha="center", fontsize=8)
    axes.set(ylabel="time of one update (ms)", title="Gradient update and its matmuls")
    axes.margins(y=0.15)
    _log_scale(axes)
    legend_below(axes, 2)


def draw_startup(axes: Axes, rows: list[Row]) -> None:
    """Draws the time from the command to the first row of metrics, as stacked phases."""
    rows = [row for row in reversed(rows) if row["what"] == "first_row"]  # barh draws upwards
    phases = ("setup", "compile", "pretrain", "first_block")
    floor = np.zeros(len(rows))
    for index, phase in enumerate(phases):
        seconds = np.array([row.get(f"{phase}_seconds", 0.0) for row in rows])
        label = phase.replace("_", " ").replace("pretrain", "first collection").replace("first block", "first epoch")
        axes.barh([f"{row['cache']} cache" for row in rows], seconds, 0.6, floor, color=COLOURS[index], label=label)
        floor = floor + seconds
    axes.set(xlabel="seconds from the command to the first metrics row", title="Start of `ear train`")
    axes.grid(axis="y", visible=False)
    legend_below(axes, 4)


def draw_peers(axes: Axes, rows: list[Row]) -> None:
    """Draws the time of an update, ours and PyTorch's."""
    rows = [row for row in rows if row["what"] == "update"]
    parts = (("ours", COLOURS[0], "ours_ms"), ("ours, bf16", COLOURS[3], "ours_bf16_ms"))
    parts += (("PyTorch", COLOURS[1], "torch_ms"), ("PyTorch, bf16", COLOURS[2], "torch_bf16_ms"))
    renamed = [(label, colour, [_rename(row, key) for row in rows]) for label, colour, key in parts]
    bars(axes, [row["preset"] for row in rows], renamed, "ms")
    axes.set(ylabel="time of one update (ms)", title="The same update in plain PyTorch")
    _log_scale(axes)
    legend_below(axes, 4)


def draw_adaptation(axes: Axes, rows: list[Row]) -> None:
    """Draws the wall time of whole commands."""
    groups = [f"ear {row['command']}\n{row['env_steps']:,} env steps" for row in rows]
    bars(axes, groups, [("", COLOURS[0], list(rows))], "seconds")
    axes.set(ylabel="seconds, start and compilation included", title="Commands on a trained policy")
    axes.set_ylim(0)


def _log_scale(axes: Axes) -> None:
    axes.set_yscale("log")
    axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.yaxis.set_major_formatter("{x:,.0f}")
    axes.yaxis.set_minor_formatter("")


def _lines(family: str) -> str:
    return family.replace("halfcheetah", "cheetah").replace("-", "\n", 1)


def _rename(row: Row, key: str) -> Row | None:
    """Returns the measurement under `key` renamed to `ms`; None if the row lacks it."""
    if key not in row:
        return None
    return {f"ms{end}": row[f"{key}{end}"] for end in ("", "_min", "_max")}


def _where(rows: list[Row]) -> str:
    """Returns the machines and commits of the rows."""
    machines = {f"{row['machine']['processor']}, {row['machine']['cores']} cores" for row in rows}
    return " · ".join([*sorted(machines), *sorted({row["commit"] for row in rows})])


def main() -> None:
    options = common.arguments(__doc__)
    panels = (
        (draw_physics, latest(options.results / "physics.jsonl", ("engine", "family", "batch", "beside"))),
        (draw_ratios, latest(options.results / "physics.jsonl", ("engine", "family", "batch", "beside"))),
        (draw_updates, latest(options.results / "update.jsonl", ("preset", "seeds", "backend"))),
        (draw_peers, latest(options.results / "peers.jsonl", ("what", "preset"))),
        (draw_startup, latest(options.results / "startup.jsonl", ("what", "module", "preset", "cache"))),
        (draw_adaptation, latest(options.results / "adaptation.jsonl", ("command",))),
    )
    with styled():
        figure, grid = subplots(3, 2, figsize=(10, 11.2), layout="constrained")
        for axes, (draw, rows) in zip(grid.flat, panels, strict=True):
            if rows:
                draw(axes, rows)
                axes.set_title(f"{axes.get_title()}\n{_where(rows)}")
            else:
                axes.set_axis_off()
        if not any(rows for _, rows in panels):
            raise RunError(f"no results in {options.results}: run the other benchmarks first")
        quick = any(row["quick"] for _, rows in panels for row in rows)
        title = "medians and ranges" + (" · quick runs, whose timings mean nothing" if quick else "")
        figure.suptitle(title, fontsize=9)
        save_figure(figure, options.results / "benchmarks.png")
    print(options.results / "benchmarks.png")


if __name__ == "__main__":
    sys.exit(exit_code("figures", main))
