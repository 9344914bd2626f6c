"""The last words of commands that train: how the run went, and commands to try next, as they can be typed here."""

from __future__ import annotations

import os
import shlex
import shutil
import sys
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from ear_jax.process.terminal import console, say

BARS = "▁▂▃▄▅▆▇█"


def say_next(*examples: tuple[str, str]) -> None:
    """Suggests commands to try next: the words after `ear`, each with its purpose."""
    lines = [(f"{program()} {words}", purpose) for words, purpose in examples]
    width = max(len(line) for line, _ in lines)
    say("\nNext:")
    for line, purpose in lines:
        wide = width + 4 + max(len(purpose) for _, purpose in lines) <= console.width
        say(f"  {line:<{width}}  {purpose}" if wide or not console.is_terminal else f"  {purpose}:\n    {line}")


def program() -> str:
    """Returns the words that start this program from here: `ear` if the PATH leads to it."""
    started = Path(sys.argv[0])
    if started.name == "ear" and started.exists():
        found = shutil.which("ear")
        return "ear" if found and os.path.samefile(found, started) else _nearby(started)
    if started.parts[-3:] == ("ear_jax", "cli", "main.py"):
        return f"{_nearby(Path(sys.executable))} -m ear_jax.cli.main"
    return "ear"


def _nearby(path: Path) -> str:
    """Returns a program's path from the working directory if it lies below that, otherwise from the root."""
    here, path = Path.cwd(), path.absolute()
    return shlex.quote(str(path.relative_to(here) if path.is_relative_to(here) else path))


def say_summary(directory: Path, rows: Sequence[dict[str, Any]]) -> None:
    """Tells how a run went: its length, its return at the start and at the end, and the curve between.

    Args:
      directory: the run's.
      rows: the run's metrics, at least one.
    """
    epochs = sorted({row["epoch"] for row in rows})
    means = [_mean([row["mean_return"] for row in rows if row["epoch"] == epoch]) for epoch in epochs]
    last = [row for row in rows if row["epoch"] == epochs[-1]]
    seeds = f", the mean of {len(last)} seeds" if len(last) > 1 else ""
    say(
        f"\n{directory}: {epochs[-1]} epochs, {last[0]['env_steps']:,} env steps and {last[0]['updates']:,} updates"
        f"{' per seed' * (len(last) > 1)} in {_minutes(last[0]['seconds'])}"
    )
    first = f"{means[0]:.1f} at epoch {epochs[0]}, " if len(means) > 1 else ""
    say(f"return: {first}{means[-1]:.1f} at epoch {epochs[-1]}{seeds}")
    if len(means) > 2:
        say(f"        {sparkline(means, min(60, console.width - 10))}")
    returns = {name: _mean([row["returns"][name] for row in last]) for name in last[0]["returns"]}
    best, worst = max(returns, key=returns.__getitem__), min(returns, key=returns.__getitem__)
    if best != worst:
        say(f"best task {best}: {returns[best]:.1f}; worst {worst}: {returns[worst]:.1f}")
    if lost := max(row.get("invalid_steps", 0.0) for row in rows):
        say(
            f"warning: up to {lost:.1f} steps of an epoch had a reward, an outcome or a state that was not finite; "
            "nothing was learnt from them"
        )


def sparkline(values: Sequence[float], width: int) -> str:
    """Draws a curve in one line of at most `width` letters, each the mean of the values that it stands for."""
    width = max(1, min(width, len(values)))
    cuts = [round(index * len(values) / width) for index in range(width + 1)]
    means = [_mean(values[start:end]) for start, end in pairwise(cuts)]
    low, high = min(means), max(means)
    return "".join(BARS[round((value - low) / (high - low or 1) * (len(BARS) - 1))] for value in means)


def _mean(values: Sequence[float]) -> float:
    return sum(values) / len(values)


def _minutes(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.0f} minutes"
