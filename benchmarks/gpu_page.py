"""Draws `gpu.png`, one page, from the rows of `gpu.jsonl`; the last row of each setting counts."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from matplotlib.axes import Axes

from benchmarks.figures import latest
from ear_jax.figures.style import COLOURS, save_figure, styled, subplots

KEYS = ("what", "family", "seeds", "device", "batch_size", "kernels", "engine", "overlap", "precision")
PANELS = (
    ("update", "update_ms", "update, ms"),
    ("collect", "collect_s", "collection of an epoch, s"),
    ("epoch", "epoch_s", "epoch, s"),
)


def draw_page(results: Path) -> Path | None:
    """Draws a panel each of updates, collection and epochs; returns the picture's path, None without such rows."""
    path, drawn = results / "gpu.jsonl", {what for what, *_ in PANELS}
    found = latest(path, KEYS) if path.exists() else []
    rows = [row for row in found if "failed" not in row and row["what"] in drawn]
    if not rows:
        return None
    with styled():
        present = [panel for panel in PANELS if any(row["what"] == panel[0] for row in rows)]
        bars = [[row for row in rows if row["what"] == what] for what, *_ in present]
        heights = [1 + len(of_panel) for of_panel in bars]
        figure, panels = subplots(
            len(present),
            figsize=(7.0, 1.5 + 0.3 * sum(heights)),
            layout="constrained",
            squeeze=False,
            gridspec_kw={"height_ratios": heights},
        )
        for axes, of_panel, (_, key, label) in zip(panels[:, 0], bars, present, strict=True):
            _bars(axes, of_panel, key, label)
        devices = ", ".join(sorted({f"{row['device']}, {row['host_cores']} cores" for row in rows}))
        figure.suptitle(devices + (" (rehearsal)" if all(row["quick"] for row in rows) else ""))
        save_figure(figure, results / "gpu.png")
    return results / "gpu.png"


def _bars(axes: Axes, rows: list[dict[str, Any]], key: str, label: str) -> None:
    """Draws a horizontal bar for each row, with the range of its runs and its number."""
    for index, row in enumerate(rows):
        low, high = row[key] - row[f"{key}_min"], row[f"{key}_max"] - row[key]
        colour = COLOURS[row.get("engine", "").startswith("mjx") or row.get("kernels", "xla") not in ("xla", "auto")]
        axes.barh(index, row[key], xerr=[[low], [high]], color=colour, error_kw={"elinewidth": 0.8})
        axes.annotate(f" {row[key]:.3g}", (row[f"{key}_max"], index), va="center", fontsize=7)
    axes.set_yticks(range(len(rows)), [_name(row) for row in rows], fontsize=7)
    axes.invert_yaxis()
    axes.margins(x=0.12)
    axes.grid(axis="y", visible=False)
    axes.set_xlabel(label)


def _name(row: dict[str, Any]) -> str:
    words = [row["family"].removesuffix("-vel"), f"{row['seeds']} seeds"]
    words += [f"batch {row['batch_size']:,}"] if "batch_size" in row else []
    words += [row[key] for key in ("engine", "kernels") if row.get(key, "auto") != "auto"]
    words += ["overlapped"] if row.get("overlap") else []
    words += [row["precision"]] if row["what"] == "update" else []
    return " · ".join(words)
