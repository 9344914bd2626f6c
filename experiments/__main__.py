"""`python -m experiments`: list the paper's tables and figures, run what is missing of each, and report them all."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro
from rich.console import Console
from rich.table import Table

from ear_jax.cli.arguments import check_least, parse
from ear_jax.cli.exits import exit_code
from ear_jax.errors import UsageError, known_name, unknown
from ear_jax.process.stopping import stop_with_parent
from ear_jax.process.terminal import say
from experiments.inventory import is_trained, jobs, missing, named_together, side_by_side
from experiments.paper import EXPERIMENTS
from experiments.reproduce import complete_all, complete_on_ray, keep, plan

PROGRAM = "python -m experiments"


@dataclass(frozen=True)
class ListCommand:
    """List every table and figure, and how much of each is recorded."""

    preset: str = "fast"
    """The preset of the runs."""
    seeds: int | None = None
    """Seeds of each run; by default the paper's number, or one for a picture."""


@dataclass(frozen=True)
class ReproduceCommand:
    """Run what is missing of a table or figure. The same command continues where it stopped.

    Several processes share the work: each takes runs that no other has started, as in `taskset -c 1 python -m
    experiments reproduce table-1`, one for each core. Each ends when all runs are complete; it takes over those of
    processes that were killed.
    """

    id: tyro.conf.Positional[str]
    """The table or figure, as in table-1 or figure-5."""
    preset: str = "fast"
    """The preset of the runs."""
    seeds: int | None = None
    """Seeds of each run; by default the paper's number, or one for a picture."""
    minutes: float | None = None
    """Stop each run after this much wall time, by default after the preset's epochs; with --plan, of the sitting."""
    together: bool = False
    """Train the missing seeds of a method side by side, as one run; on an accelerator this takes little more time."""
    only: str | None = None
    """One run of the table or figure, as in halfcheetah-vel-ear-fast-seed0."""
    on: Literal["here", "ray"] = "here"
    """The place to work: here, or each run as a task of a Ray cluster (pip install 'ear-jax[cluster]')."""
    cores: int = 1
    """Cores of each run on a Ray cluster without GPUs; with GPUs each run has one."""
    dry_run: bool = False
    """Only print the commands."""
    plan: bool = False
    """Print a shell script of the missing runs that fit into --minutes at an accelerator, seeds side by side."""


@dataclass(frozen=True)
class KeepCommand:
    """Make a record of a run of `ear train`, with one seed or several side by side."""

    run: tyro.conf.Positional[Path]
    """The run directory."""
    name: str | None = None
    """The record's name; by default FAMILY-AGENT-PRESET-seedN, which the paper's tables look for."""


def list_all(words: list[str]) -> None:
    command = parse(ListCommand, words, "list", program=PROGRAM)
    check_seeds(command.seeds)
    table = Table()
    for heading in ("", "shows", "runs", "analyses"):
        table.add_column(heading, overflow="fold")
    for experiment in EXPERIMENTS.values():
        wanted = jobs(experiment, command.preset, command.seeds)
        analyses = sum(len(job.analyses) for job in wanted)
        done = analyses - sum(len(missing(job)) for job in wanted)
        counts = (
            f"{sum(map(is_trained, wanted))}/{len(wanted)}" if wanted else "–",
            f"{done}/{analyses}" if analyses else "–",
        )
        table.add_row(experiment.id, experiment.shows, *counts)
    Console(highlight=False).print(table)
    print(f"`{PROGRAM} reproduce ID` runs what is missing; with --dry-run it only prints the commands.")


def reproduce(words: list[str]) -> None:
    command = parse(ReproduceCommand, words, "reproduce", program=PROGRAM)
    check_seeds(command.seeds)
    check_least(command, cores=1)
    if command.id not in EXPERIMENTS:
        raise unknown("table or figure", command.id, EXPERIMENTS)
    if command.plan:
        print_plan(command)
        return
    wanted = jobs(EXPERIMENTS[command.id], command.preset, command.seeds, command.minutes)
    if command.only is not None and command.together and (job := named_together(wanted, command.only)):
        wanted = [job]
    elif command.only is not None:
        named = {job.name: job for job in wanted}
        wanted = [named[known_name("run", command.only, named)]]
    elif command.together:
        wanted = side_by_side(wanted)
    if command.dry_run:
        for line in (line for job in wanted for line in plan(job)):
            print(line)
        return
    if command.on == "ray":
        given = {"--seeds": command.seeds, "--minutes": command.minutes}
        options = [str(word) for name, value in given.items() if value is not None for word in (name, value)]
        options += ["--together"] if command.together else []
        complete_on_ray(wanted, ["reproduce", command.id, "--preset", command.preset, *options], command.cores)
    complete_all(wanted)
    say(f"{command.id} is complete: {len(wanted)} runs")


def print_plan(command: ReproduceCommand) -> None:
    """Prints the sitting that a command asks for."""
    if command.minutes is None:
        raise UsageError("--plan needs --minutes, the length of the sitting")
    from experiments.sitting import plan_sitting, script, timed_runs  # slow to import: JAX

    timed = timed_runs()
    wanted = side_by_side(jobs(EXPERIMENTS[command.id], command.preset, command.seeds))
    words = [*PROGRAM.split(), "reproduce", command.id, "--preset", command.preset, "--together"]
    words += ["--seeds", str(command.seeds)] if command.seeds else []
    sitting = plan_sitting(wanted, command.minutes, timed)
    print("\n".join(script(sitting, words, timed)))


def check_seeds(seeds: int | None) -> None:
    if seeds is not None and seeds < 1:
        raise UsageError(f"--seeds {seeds} is too small; it must be at least 1")


def keep_run(words: list[str]) -> None:
    command = parse(KeepCommand, words, "keep", program=PROGRAM)
    say(f"recorded as {keep(command.run, command.name)}")


def report(words: list[str]) -> None:
    from experiments.report import command  # slow to import: matplotlib and JAX

    command.report(words)


def publish(words: list[str]) -> None:
    from experiments.publish import main  # slow to import: JAX and MuJoCo

    main(words)


COMMANDS = {"list": list_all, "reproduce": reproduce, "keep": keep_run, "report": report, "publish": publish}


def main(arguments: list[str] | None = None) -> int:
    """Runs one command line; returns the exit code: 0, 1, 2 (usage), 130, 143 or 129 (stopped, and saved)."""
    words = sys.argv[1:] if arguments is None else arguments
    stop_with_parent()
    return exit_code("experiments", lambda: _run(words))


def _run(words: list[str]) -> None:
    if words[:1] in (["-h"], ["--help"]):
        print(f"{__doc__}\n\ncommands: {', '.join(COMMANDS)}; `{PROGRAM} COMMAND --help` lists its options")
        return
    if not words or words[0] not in COMMANDS:
        raise unknown("command", words[0] if words else "", COMMANDS)
    COMMANDS[words[0]](words[1:])


if __name__ == "__main__":
    sys.exit(main())
