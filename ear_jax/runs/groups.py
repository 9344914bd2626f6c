"""Runs read from their records and grouped: equal settings with other seeds are one curve. Imports no JAX."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import numpy as np

from ear_jax.config import flat, from_dict
from ear_jax.errors import UsageError, unknown
from ear_jax.runs import records

Rows = list[dict[str, Any]]

AXES = {"updates": "updates", "steps": "env_steps", "minutes": "seconds"}  # name → key of a row
APART = ("seed", "seeds", "engine", "minutes", "checkpoint.*", "log.*")  # settings that leave runs in one group


@dataclass(frozen=True)
class RunRecords:
    """A run's records."""

    path: Path
    settings: dict[str, Any]  # by dotted name, complete
    seeds: dict[int, Rows]  # seed → its rows of metrics, by epoch

    @property
    def kind(self) -> dict[str, Any]:
        """The settings that tell groups apart."""
        return {
            name: value for name, value in self.settings.items() if not any(fnmatch(name, pattern) for pattern in APART)
        }


@dataclass(frozen=True)
class Group:
    """Seeds of one kind, perhaps from several runs."""

    name: str
    runs: tuple[RunRecords, ...]

    @property
    def seeds(self) -> list[Rows]:
        """The rows of every seed."""
        return [rows for run in self.runs for rows in run.seeds.values()]


def read(path: Path) -> RunRecords:
    """Reads a run's settings and metrics.

    Raises:
      UsageError: there is no run, or it has no row of metrics yet.
      RunError: its records cannot be read.
    """
    document = records.read_run(path)
    rows = records.read_rows(path / "metrics.jsonl", required=records.METRICS)
    if not rows:
        raise UsageError(f"{path} has no row of metrics yet")
    seeds = {seed: [row for row in rows if row["seed"] == seed] for seed in sorted({row["seed"] for row in rows})}
    return RunRecords(path, flat(from_dict(document["config"])), seeds)


def group(runs: Iterable[RunRecords]) -> list[Group]:
    """Groups runs of equal settings whose seeds differ, in the order given; a repeated seed begins another group."""
    groups: list[list[RunRecords]] = []
    for run in runs:
        mine = (
            members
            for members in groups
            if members[0].kind == run.kind and not any(member.seeds.keys() & run.seeds.keys() for member in members)
        )
        home = next(mine, None)
        if home is None:
            groups.append([run])
        else:
            home.append(run)
    short = [_without_seed(members[0].path) for members in groups]
    unique = len(set(short)) == len(short)
    return [
        Group(name if unique else str(members[0].path), tuple(members))
        for name, members in zip(short, groups, strict=True)
    ]


def two_groups(ours: Sequence[Path], theirs: Sequence[Path]) -> tuple[Group, Group]:
    """Reads runs as two groups, whatever their settings.

    Raises:
      UsageError: a run is given twice, or as `read` does.
    """
    paths = (*ours, *theirs)
    places = [path.resolve() for path in paths]
    for path, place in zip(paths, places, strict=True):
        if places.count(place) > 1:
            raise UsageError(f"{path} is given twice")
    one, other = (tuple(map(read, group)) for group in (ours, theirs))
    names = [_name(one), _name(other)]
    if names[0] == names[1]:
        names = [str(group[0]) for group in (ours, theirs)]
    return Group(names[0], one), Group(names[1], other)


def metric_names(rows: Rows) -> list[str]:
    """Returns the names of the numbers in rows, the returns of single tasks among them."""
    last = rows[-1]
    numbers = [name for name, value in last.items() if isinstance(value, int | float)]
    return [name for name in numbers if name not in ("seed", "epoch")] + list(last.get("returns", {}))


def curve(rows: Rows, metric: str, by: str) -> tuple[np.ndarray, np.ndarray]:
    """Returns one seed's curve: places on the axis [rows] and the metric there [rows].

    Args:
      rows: the seed's rows of metrics.
      metric: a name of `metric_names`.
      by: an axis of `AXES`; minutes are wall time.

    Raises:
      UsageError: the rows have no such metric.
    """
    names = metric_names(rows)
    if metric not in names:
        raise unknown("metric", metric, names)
    present = [row for row in rows if metric in row or metric in row.get("returns", {})]
    places = np.array([row[AXES[by]] for row in present], float)
    values = np.array([row.get(metric, row.get("returns", {}).get(metric)) for row in present], float)
    return places / (60 if by == "minutes" else 1), values


def band(members: Group, metric: str, by: str) -> tuple[np.ndarray, np.ndarray]:
    """Returns the curves of a group on one axis: places [points] and every seed's metric there [seeds, points].

    Seeds are interpolated linearly over the part of the axis that all of them cover.
    """
    curves = [curve(rows, metric, by) for rows in members.seeds]
    first = max(places[0] for places, _ in curves)
    last = min(places[-1] for places, _ in curves)
    places = np.unique(np.concatenate([places for places, _ in curves]))
    places = places[(places >= first) & (places <= last)]
    return places, np.stack([np.interp(places, own, values) for own, values in curves])


def _name(runs: Sequence[RunRecords]) -> str:
    """Returns the name of a group, without its seeds if there are several."""
    several = sum(len(run.seeds) for run in runs) > 1
    return _without_seed(runs[0].path) if several else runs[0].path.name


def _without_seed(path: Path) -> str:
    """Returns the name of a run without its seeds: walker-vel-ear-fast-seeds0-4 is walker-vel-ear-fast."""
    return re.sub(r"-seeds?\d+(-\d+)?$", "", path.name)
