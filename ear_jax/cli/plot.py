"""`ear plot RUN…`."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from ear_jax.cli.arguments import option, parse, required
from ear_jax.cli.results import print_pictures, short_hash
from ear_jax.errors import UsageError
from ear_jax.process.terminal import say
from ear_jax.runs.groups import Group, RunRecords, group, read

PLOTS = Path("plots")


@dataclass(frozen=True)
class PlotCommand:
    """Draw the training curves of runs. Runs that differ only in their seeds are one curve with a band.

    Example: ear plot runs/halfcheetah-vel-ear-fast-seed0 --by minutes
    """

    runs: tyro.conf.Positional[Annotated[tuple[Path, ...], required("RUN [RUN ...]")]]
    """Run directories."""
    metric: Annotated[str, option("METRIC", "mean_return")] = "mean_return"
    """A metric of `metrics.jsonl`, such as entropy, or a task, such as vel-2; an unknown name lists all."""
    by: Literal["updates", "steps", "minutes"] = "updates"
    """The horizontal axis: updates, env steps or minutes of wall time."""
    out: Annotated[Path | None, option("FILE", "plots/NAMES_METRIC_by_AXIS_HASH, as .png and .svg")] = None
    """The file; its ending is the format: .png, .svg or .pdf."""
    json: bool = False
    """Print one JSON document and nothing else."""


def main(words: list[str]) -> None:
    command = parse(PlotCommand, words, "plot")
    if not command.runs:
        raise UsageError("name at least one run")
    groups = group(_readable(command.runs))
    from ear_jax.figures.formats import check_format
    from ear_jax.figures.plot import draw_plot

    if command.out is not None:
        check_format(command.out)
    paths = draw_plot(_files(command, groups), groups, command.metric, command.by)
    if command.json:
        curves = [
            {"name": one.name, "runs": [str(run.path) for run in one.runs], "seeds": len(one.seeds)} for one in groups
        ]
        files = [str(path) for path in paths]
        print(json.dumps({"metric": command.metric, "by": command.by, "curves": curves, "figures": files}))
    else:
        print_pictures(paths)


def _readable(paths: Iterable[Path]) -> list[RunRecords]:
    """Reads the runs among some paths, and tells which are none: `runs/*` also names results of pretrained agents.

    Raises:
      UsageError: a path does not exist, or none is a run with metrics.
    """
    found, refused = [], []
    for path in dict.fromkeys(paths):
        try:
            found.append(read(path))
        except UsageError as error:
            if not path.exists():
                raise
            refused.append(error)
    if not found:
        raise refused[0]
    for reason in refused:
        say(f"left out: {reason}")
    return found


def _files(command: PlotCommand, groups: list[Group]) -> list[Path]:
    if command.out is not None:
        return [command.out]
    names = [Path(one.name).name for one in groups]
    named = "_".join(names) if len(names) < 3 else f"{names[0]}_and_{len(names) - 1}_more"
    which = short_hash(" ".join(str(run.absolute()) for run in command.runs))  # other runs may have the same names
    stem = re.sub(r"[^\w.+-]+", "_", f"{named}_{command.metric}_by_{command.by}_{which}")
    return [PLOTS / f"{stem}.png", PLOTS / f"{stem}.svg"]
