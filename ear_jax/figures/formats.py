"""Figures as files in the format that their ending names."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from ear_jax.errors import UsageError
from ear_jax.figures.style import save_figure

FORMATS = (".png", ".svg", ".pdf")
UNDATED: Any = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}


def check_format(path: Path) -> None:
    """Raises UsageError unless a path ends in one of `FORMATS`."""
    if path.suffix.lower() not in FORMATS:
        raise UsageError(f"{path} cannot hold a figure; it must end in {', '.join(FORMATS[:-1])} or {FORMATS[-1]}")


def write_figure(figure: Figure, *paths: Path) -> list[Path]:
    """Writes a figure to files of `FORMATS` and returns the paths; raises RunError if that fails."""
    endings = [path.suffix.lower() for path in paths]
    return [
        save_figure(figure, path, format=ending[1:], metadata=UNDATED.get(ending))
        for path, ending in zip(paths, endings, strict=True)
    ]
