"""`ear compare RUN RUN`."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import tyro

from ear_jax.cli.arguments import option, parse, required
from ear_jax.cli.plot import PLOTS
from ear_jax.cli.results import print_table, short_hash, show_and_keep
from ear_jax.errors import UsageError, plain
from ear_jax.runs.comparison import compare
from ear_jax.runs.groups import two_groups

RETURNS = ("mean", "interquartile_mean")
COUNTS = ("seeds", "episodes", "updates", "env_steps", "minutes")
NAMES = {"interquartile_mean": "interquartile mean", "episodes": "episodes a task", "env_steps": "env steps"}


@dataclass(frozen=True)
class CompareCommand:
    """Compare two runs, or two groups of runs: settings that differ, returns, and how often one beats the other.

    Example: ear compare runs/halfcheetah-vel-ear-fast-seed0 runs/halfcheetah-vel-multihead-fast-seed0
    """

    runs: tyro.conf.Positional[Annotated[tuple[Path, ...], required("RUN [RUN ...]")]]
    """Two run directories; or, with --against, all runs of the first group."""
    against: Annotated[tuple[Path, ...], option("[RUN ...]", "the second run")] = ()
    """The runs of the second group."""
    out: Annotated[Path | None, option("FILE", "plots/ONE_against_OTHER_HASH.png")] = None
    """The figure's file; its ending is the format: .png, .svg or .pdf."""
    json: bool = False
    """Print one JSON document and nothing else."""


def main(words: list[str]) -> None:
    command = parse(CompareCommand, words, "compare")
    if not command.runs or (not command.against and len(command.runs) != 2):
        raise UsageError("give two runs, or the runs of the second group after --against")
    ours, theirs = (command.runs, command.against) if command.against else (command.runs[:1], command.runs[1:])
    document = compare(*two_groups(ours, theirs))
    from ear_jax.figures.compare import draw_compare
    from ear_jax.figures.formats import check_format

    if command.out is not None:
        check_format(command.out)
    which = short_hash(" ".join(str(run.absolute()) for run in (*ours, Path("against"), *theirs)))
    file = command.out or PLOTS / f"{ours[0].name}_against_{theirs[0].name}_{which}.png"
    show_and_keep(document, command.json, _print, partial(draw_compare, [file], document))


def _print(document: dict[str, Any]) -> None:
    first, second = document["groups"]
    if document["settings"]:
        rows = [(setting["name"], *map(str, setting["values"])) for setting in document["settings"]]
        print_table(("setting", first["name"], second["name"]), rows, "settings that differ")
        print()
    else:
        print("settings: equal, apart from seeds")
    returns = {name: [_with_interval(group[name], ".1f") for group in (first, second)] for name in RETURNS}
    counts = {name: [_numbers(group[name]) for group in (first, second)] for name in COUNTS}
    rows = [(NAMES.get(name, name), *values) for name, values in (returns | counts).items()]
    print_table(("", f"{first['name']}>", f"{second['name']}>"), rows, f"returns, from {document['returns_from']}")
    chance = _with_interval(document["probability_of_improvement"], ".2f")
    print(plain(f"On the same task, a seed of {first['name']} beats a seed of {second['name']}: probability {chance}"))
    if not document["probability_of_improvement"]["interval"]:
        print("Intervals need at least two seeds of each.")


def _with_interval(entry: dict[str, Any], form: str) -> str:
    interval = f" [{entry['interval'][0]:{form}}, {entry['interval'][1]:{form}}]" if entry["interval"] else ""
    return f"{entry['value']:{form}}{interval}"


def _numbers(value: Any) -> str:
    return " / ".join(f"{one:,}" for one in (value if isinstance(value, list) else [value]))
