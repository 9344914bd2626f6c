"""`ear sweep FAMILY`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import product
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from ear_jax.cli import train
from ear_jax.cli.arguments import check_least, option
from ear_jax.cli.results import keep, print_table, show_and_keep
from ear_jax.config import Config, flag, flat, run_name
from ear_jax.errors import UsageError, counted, hint, unknown
from ear_jax.limits import check
from ear_jax.presets import check_effect
from ear_jax.process import hosts
from ear_jax.process.hosts import Hosts
from ear_jax.process.terminal import say
from ear_jax.runs import sweep
from ear_jax.runs.failure import NAME as REPORT
from ear_jax.runs.failure import Diverged, reported
from ear_jax.runs.groups import group
from ear_jax.runs.groups import read as read_records

Lists = tuple[tuple[str, ...], ...]
SHOWN = 12  # curves in the figure
FIXED = ("family", "seed", "seeds", "tasks")  # settings that cannot vary within a sweep


@dataclass(frozen=True)
class SweepCommand:
    """Train a run for every combination of some settings' values: ear sweep FAMILY --vary sac.lr 3e-4 1e-3.

    Runs that differ in numbers only, such as sac.lr, train side by side in one program; others follow one another. Each
    is a run like those of `ear train`, in a directory of its own. The same command continues an unfinished sweep.

    Example: ear sweep hopper-vel --vary sac.lr 3e-4 1e-3 --vary sac.discount 0.98 0.99 --seeds 2
    """

    config: Annotated[tyro.conf.FlagConversionOff[Config], tyro.conf.arg(name="")]
    vary: Annotated[tyro.conf.UseAppendAction[Lists], tyro.conf.arg(metavar="SETTING VALUE ...")] = ()
    """A setting and its values."""
    out: Annotated[Path | None, option("DIRECTORY", "runs/FAMILY-AGENT-PRESET-seedN-sweep-SETTINGS")] = None
    """The sweep's directory."""
    hosts: Hosts = field(default_factory=Hosts)
    on: Literal["here", "ray"] = "here"
    """The place to train: here, or each run as a task of a Ray cluster (pip install 'ear-jax[cluster]')."""
    cores: int = 1
    """Cores of each run on a Ray cluster without GPUs; with GPUs each run has one."""
    dry_run: bool = False
    """Print the runs, the memory they need and their speed on this machine, without training or writing."""
    json: bool = False
    """Print one JSON document and nothing else."""

    @property
    def directory(self) -> Path:
        """The sweep's directory."""
        settings = "-".join(setting for setting, *_ in self.vary)
        return self.out or Path("runs") / f"{run_name(self.config)}-sweep-{settings}"

    def check_place(self) -> None:
        """Checks that the directory can hold the sweep; raises UsageError or RunError."""
        sweep.check_place(self.directory)


@dataclass(frozen=True)
class Trial:
    """One combination of values."""

    name: str  # also of its directory
    changes: dict[str, Any]  # setting → value
    config: Config


def main(words: list[str]) -> None:
    command, trials = read(words)
    from ear_jax.runs.on_ray import load_ray
    from ear_jax.runs.side_by_side import programs

    directory, configs = command.directory, [trial.config for trial in trials]
    groups = [[trials[index] for index in members] for members in programs(configs)]
    if command.dry_run:
        print_plan(groups, directory)
        return
    if command.on == "ray":
        load_ray()
    plan = {trial.name: trial.changes for trial in trials}
    with hosts.parting():
        hosts.agree(lambda: sweep.begin(directory, command.config.family, plan))
        if command.on == "ray":
            train_on_ray(trials, directory, command.cores)
        for members in groups if command.on == "here" else ():
            train_together(members, directory)
    if hosts.index() > 0:
        return
    document = sweep.describe(directory)
    kept = partial(keep, directory, Path(sweep.NAME).stem, "", document, draw)
    show_and_keep(document, command.json, _print, kept)


def train_together(trials: Sequence[Trial], directory: Path) -> None:
    """Trains trials side by side. One whose numbers were not finite stays failed, and other programs go on."""
    from ear_jax.runs.loop import Run, train_runs

    failed = hosts.agree(lambda: [trial.name for trial in trials if reported(directory / trial.name)])
    for name in failed:
        say(f"{name} failed before, see {directory / name / REPORT}")
    if len(failed) == len(trials):
        return
    try:
        train_runs([Run(trial.config, directory / trial.name) for trial in trials])
    except Diverged as error:
        say(f"warning: {error}; the sweep goes on")


def train_on_ray(trials: Sequence[Trial], directory: Path, cores: int) -> None:
    """Trains every trial as a task of a Ray cluster; raises RunError if some fail for want of something.

    One whose numbers were not finite stays failed.
    """
    from ear_jax.runs import on_ray

    jobs = []
    for trial in trials:
        run = directory / trial.name
        if reported(run):
            continue
        words = ("ear_jax.cli.main", "train", *words_of(trial.config), "--out", str(run))
        jobs.append(on_ray.Job(trial.name, words, run, trial.config.epochs))
    failed = on_ray.run_jobs(jobs, directory / "logs", cores)
    unfinished = {name: reason for name, reason in failed.items() if not reported(directory / name)}
    on_ray.check(unfinished, directory / "logs")


def draw(figures: Path, document: dict[str, Any], label: str) -> list[Path]:
    """Draws the trials' curves, the best first; returns the paths."""
    from ear_jax.figures.plot import draw_plot

    shown = [figures.parent / trial["name"] for trial in document["trials"] if trial["curve"]][:SHOWN]
    runs = group([read_records(run) for run in shown])
    return draw_plot([figures / f"sweep{label}.png"], runs, "mean_return", "updates") if runs else []


def read(words: list[str]) -> tuple[SweepCommand, list[Trial]]:
    """Parses the command line; each trial's settings are parsed as if the line had named its values."""
    command = train.read(words, SweepCommand, "sweep", _meet)
    check_least(command, cores=1)
    rest = list(_without("--vary", words))
    if not command.vary:
        raise UsageError("name a setting to vary: ear sweep FAMILY --vary SETTING VALUE … (see `ear sweep --help`)")
    settings = flat(command.config)
    for name, *values in command.vary:
        _check_setting(name.replace("-", "_"), values, settings, rest)
    names = [name.replace("-", "_") for name, *_ in command.vary]
    if twice := [name for name in names if names.count(name) > 1]:
        raise UsageError(f"--vary {twice[0]} is given twice; name all its values after one --vary")
    trials = []
    for combination in product(*(given[1:] for given in command.vary)):
        chosen = dict(zip(names, combination, strict=True))
        line = [word for name, value in chosen.items() for word in (flag(name), value)]
        config = train.read([*rest, *line], SweepCommand, "sweep").config
        check(config)
        check_effect(config)
        name = ",".join(f"{name}={value}" for name, value in chosen.items()).replace("/", "-")
        trials.append(Trial(name, {name: flat(config)[name] for name in names}, config))
    if len({trial.config for trial in trials}) < len(trials):
        raise UsageError("--vary names a value twice")
    return command, trials


def _meet(command: SweepCommand) -> None:
    if command.on == "ray" and command.hosts != Hosts():
        raise UsageError("--on ray spreads runs over hosts by itself; leave out --hosts")
    train.meet(command)


def _check_setting(name: str, values: Sequence[str], settings: dict[str, Any], rest: Sequence[str]) -> None:
    """Raises UsageError for a setting that cannot vary, or has no values, or has a value elsewhere."""
    if name not in settings:
        same = [setting for setting in settings if setting.rpartition(".")[2] == name]
        raise UsageError(f"unknown setting {name!r}{hint(same)}") if same else unknown("setting", name, settings)
    if name in FIXED:
        raise UsageError(f"--vary {name} is not possible: trials share family, tasks and seeds")
    if len(values) < 2:
        raise UsageError(f"--vary {name} needs two values or more")
    if any(word.split("=")[0] == flag(name) for word in rest):
        raise UsageError(f"{flag(name)} is given and varied; leave out one of the two")


def _without(option: str, words: Sequence[str]) -> Iterator[str]:
    """Yields the words outside an option and its values."""
    inside = False
    for word in words:
        if word.startswith("--"):
            inside = word == option
        if not inside:
            yield word


def print_plan(groups: Sequence[Sequence[Trial]], directory: Path) -> None:
    """Prints the programs of a sweep, their runs and their cost; raises the errors that the sweep would raise."""
    from ear_jax.runs.fastest import with_engine
    from ear_jax.runs.side_by_side import members
    from ear_jax.runs.training import make_program

    for number, trials in enumerate(groups, start=1):
        print(f"program {number} of {len(groups)}: {counted(len(trials), 'run')} side by side, in {directory}")
        for trial in trials:
            print(f"  {trial.name}")
        config = with_engine(members([trial.config for trial in trials]), say)
        train.print_cost(make_program(config))


def _print(document: dict[str, Any]) -> None:
    results = ("return>", "± between seeds>", "mean over the run>", "updates>", "minutes>")
    rows = [(*map(str, trial["settings"].values()), *_numbers(trial)) for trial in document["trials"]]
    print_table((*document["trials"][0]["settings"], *results), rows)


def _numbers(trial: dict[str, Any]) -> list[str]:
    if trial["failed"]:
        return [f"failed: {trial['failed']}", "", "", "", ""]
    updates, _, seconds, _ = trial["curve"][-1]
    return [
        f"{trial['return']:.1f}",
        "" if trial["deviation"] is None else f"{trial['deviation']:.1f}",
        f"{trial['mean_over_run']:.1f}",
        f"{updates:,}",
        f"{seconds / 60:.1f}",
    ]


def words_of(config: Config) -> list[str]:
    """Returns the words that name every setting on the command line, the family first."""
    words = [config.family]
    for name, value in flat(config).items():
        if name != "family" and value not in (None, ()):
            words += [flag(name), *map(str, value if isinstance(value, tuple) else (value,))]
    return words
