"""`ear train FAMILY`."""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from ear_jax.cli.arguments import HELP, option, parse
from ear_jax.cli.closing import say_next, say_summary
from ear_jax.config import Config, flat
from ear_jax.config_files import Settings, read_settings, with_settings
from ear_jax.errors import RunError, UsageError, known_name
from ear_jax.limits import check
from ear_jax.names import ENGINES, FAMILIES, METHODS, family_name
from ear_jax.presets import check_effect, draft_config, parts, preset_config
from ear_jax.process.environment import start_jax
from ear_jax.process.hosts import Hosts, index, join, parting
from ear_jax.process.streams import results_only
from ear_jax.process.terminal import say, sign_of_life
from ear_jax.runs import records
from ear_jax.runs.directory import check_place, default_directory

if TYPE_CHECKING:
    from ear_jax.runs.training import Program


@dataclass(frozen=True)
class TrainCommand:
    """Train a policy on a family of tasks: ear train FAMILY. The same command continues an unfinished run.

    Example: ear train halfcheetah-vel --tasks 1 3 5 --sac.lr 3e-4 --seeds 2
    """

    config: Annotated[tyro.conf.FlagConversionOff[Config], tyro.conf.arg(name="")]
    file: Annotated[Path | None, tyro.conf.arg(name="config", metavar="FILE", help_behavior_hint="(default: none)")] = (
        None
    )
    """Settings from a TOML file, such as `ear config` prints, or from a run's config.json; flags go over them."""
    out: Annotated[Path | None, option("DIRECTORY", "runs/FAMILY-AGENT-PRESET-seedN")] = None
    """The run directory."""
    hosts: Hosts = field(default_factory=Hosts)
    dry_run: bool = False
    """Print the settings, the memory they need and their speed on this machine, without training or writing."""

    @property
    def directory(self) -> Path:
        """The run's directory."""
        return self.out or default_directory(self.config)

    def check_place(self) -> None:
        """Checks that the directory can hold the run; raises UsageError or RunError."""
        check_place(self.directory)


def main(words: list[str]) -> None:
    command = read(words, before_jax=meet)
    check_effect(command.config)
    if command.dry_run:
        print_estimate(command.config, command.directory)
    else:
        with parting():
            train(command.config, command.directory)


def train(config: Config, directory: Path) -> None:
    """Trains a run, and tells at the end how it went and what can be done with it, by process 0 of several."""
    from ear_jax.process.stopping import Stopped
    from ear_jax.runs.loop import train_run

    try:
        train_run(config, directory)
    except Stopped:
        if index() == 0:
            draw_curves(directory)
        raise
    if index() > 0:
        return
    draw_curves(directory)
    rows = records.read_rows(directory / "metrics.jsonl", lambda _: None)  # the run itself has told of damage
    if not rows:
        return
    say_summary(directory, rows)
    run, own = shlex.quote(str(directory)), f" --family {shlex.quote(config.family)}" * (config.family not in FAMILIES)
    say_next(
        (f"evaluate {run}{own}", "what it achieves on each task"),
        (f"render {run}{own} --task {shlex.quote(next(iter(rows[-1]['returns'])))}", "a film of the robot"),
        (f"export {run}{own} {shlex.quote(directory.name)}.safetensors", "its policy in one file"),
    )


def draw_curves(directory: Path) -> None:
    """Draws the curves of a run that trained, unless it has them already; a failure is a warning."""
    from ear_jax.figures.train import draw_train

    try:
        for path in draw_train(directory):
            say(f"curves: {path}")
    except (UsageError, RunError) as error:
        say(f"warning: the training curves were not drawn: {error}")


def print_estimate(config: Config, directory: Path) -> None:
    """Prints the estimate of `--dry-run`; raises the errors that `ear train` would raise."""
    from ear_jax.runs.documents import header
    from ear_jax.runs.estimate import check_memory
    from ear_jax.runs.fastest import with_engine
    from ear_jax.runs.training import make_program

    check_place(directory)
    with results_only():
        program = make_program(with_engine(config, say))
    check_memory(program)
    print(header(program, directory))
    for name, value in flat(config).items():
        print(f"  {name.replace('_', '-')} {value}")
    print_cost(program)


def print_cost(program: Program) -> None:
    """Prints the memory that a program needs and its speed here; raises RunError if it does not fit."""
    from ear_jax.runs.estimate import check_memory, describe, gigabytes, memory, times

    check_memory(program)
    config, needed = program.config, memory(program)
    free = f"; {gigabytes(needed.room.bytes)} are free under {needed.room.limit}" if needed.room else ""
    print(f"memory: {gigabytes(needed.total)} ({describe(needed)}){free}")
    taken = times(config)
    blocks = math.ceil(config.epochs / config.log.epochs)
    minutes = (config.epochs * taken.epoch + blocks * taken.evaluation) / 60
    print(
        f"time here: {taken.compiling:.0f} s to compile, {taken.epoch:.2f} s per epoch, {taken.evaluation:.2f} s per "
        f"evaluation every {config.log.epochs} epochs; {config.epochs} epochs take {minutes:.0f} minutes"
    )


def meet(command: Any) -> None:
    """Checks the place and joins the other processes of a run over several hosts; raises UsageError or RunError."""
    command.check_place()
    if command.dry_run and command.hosts != Hosts():
        raise UsageError("--dry-run estimates a run on one host; leave out --hosts and give the seeds of one")
    join(command.hosts)


def ignore(_: Any) -> None:
    """Does nothing."""


def read(
    words: list[str],
    kind: type[Any] = TrainCommand,
    name: str = "train",
    before_jax: Callable[[Any], None] = ignore,
) -> Any:
    """Parses the command line, over the settings of the file, the preset and the agent that it names.

    Mistyped names, options and values are refused before JAX is imported, over a draft of these settings.

    Args:
      words: the words after the subcommand.
      kind: the command's dataclass; it has `config`, which alone is required.
      name: the subcommand.
      before_jax: called with the command before JAX is imported, as far as it can be parsed until then.
    """
    file = _option(words, "--config", "")
    settings = read_settings(Path(file).expanduser()) if file else {}
    family, rest = _family(words, settings, name)
    rest = _known(rest, "--agent", lambda name: known_name("agent", name, METHODS))
    rest = _known(rest, "--engine", lambda name: known_name("engine", name, ("auto", *ENGINES)))
    rest = _known(rest, "--preset", lambda name: "+".join((parts(name)[0], *parts(name)[1])))
    preset = _option(rest, "--preset", settings.get("preset", "fast"))
    agent = _option(rest, "--agent", settings.get("agent", "ear"))
    if preset != settings.get("preset", preset):
        raise UsageError(f"--preset {preset} does not go with {file}, whose settings are those of {settings['preset']}")
    if (of := settings.get("family", family)) != family and settings.get("tasks") and "--tasks" not in rest:
        raise UsageError(f"{file} has tasks of {of}; name those of {family} with --tasks")
    settings = {**settings, "family": family, "agent": agent}
    drafted = (family, agent) == (FAMILIES[0], "ear")  # whose presets are as drafted
    if drafted or not set(HELP) & set(rest):
        draft = draft_config(family, preset, agent)
        command = parse(kind, [family, *rest], name, kind(with_settings(draft, settings)))
        check(command.config)
        before_jax(command)
    with sign_of_life("loading"):
        start_jax()
        base = preset_config(family, preset, agent)
    return parse(kind, [family, *rest], name, kind(with_settings(base, settings)))


def _known(words: list[str], name: str, known: Callable[[str], str]) -> list[str]:
    """Replaces each value given to an option by the name that it means."""
    replaced = []
    for before, word in zip(("", *words), words, strict=False):
        if before == name and not word.startswith("--"):
            word = known(word)
        elif word.startswith(name + "="):
            word = f"{name}={known(word.partition('=')[2])}"
        replaced.append(word)
    return replaced


def _option(words: list[str], name: str, default: str) -> str:
    """Returns the last value given to an option, before the whole command line is parsed."""
    value = default
    for word, following in zip_longest(words, words[1:]):
        if word == name and following is not None:
            value = following
        elif word.startswith(name + "="):
            value = word.partition("=")[2]
    return value


def _family(words: list[str], settings: Settings, command: str) -> tuple[str, list[str]]:
    """Splits the words into the family, which comes first unless a file of settings names it, and the rest."""
    if words and words[0] in HELP:
        return FAMILIES[0], words
    if (not words or words[0].startswith("-")) and "family" in settings:
        return family_name(settings["family"]), words
    if not words or words[0].startswith("-"):
        raise UsageError(f"name a family first: ear {command} FAMILY (there are: {', '.join(sorted(FAMILIES))})")
    return family_name(words[0]), words[1:]
