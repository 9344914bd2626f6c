"""A sitting at an accelerator: the missing runs of a table that fit into some minutes, as a shell script.

A run takes as long as the most similar one that is recorded from an accelerator, for as many updates.
"""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass

from ear_jax.errors import UsageError
from experiments.inventory import Job, is_complete, missing
from experiments.report.run_index import Run, recorded_runs

ANALYSIS = 40.0  # seconds, most of them to compile
MORE_SEEDS = 0.05  # of a run's time, for each further seed beside it: sixteen took half as much again as five
FILE_MIB, FILES = 16, 8  # what comes back from a sitting
RECORD_MIB = 3.0  # of one seed, at most; MAML's 100 codes take most


@dataclass(frozen=True)
class Sitting:
    """The runs of a sitting in order, and those that are left for another, with the seconds of each."""

    minutes: float
    fits: Sequence[tuple[Job, float]]
    left: Sequence[tuple[Job, float | None]]  # None: nothing like it is recorded from an accelerator

    @property
    def seconds(self) -> float:
        return sum(seconds for _, seconds in self.fits)


def timed_runs() -> list[Run]:
    """Returns the runs that are recorded from an accelerator; of seeds side by side each counts, and they agree."""
    return [run for run in recorded_runs() if "accelerator" in run.about["machine"]]


def seconds_of(job: Job, timed: Sequence[Run]) -> float | None:
    """Estimates how long a job takes on an accelerator, with its analyses; None if nothing like it was timed.

    The most similar run has the same family and agent, or else the same family, or else it is the slowest of all.
    """
    config = job.config
    like = [run for run in timed if run.config.sac.updates == config.sac.updates]
    if not like:
        return None
    same = [run for run in like if run.config.family == config.family]
    nearest = [run for run in same if run.config.agent == config.agent] or same or like
    slowest = max(nearest, key=_seconds_an_epoch)
    more = max(0, config.seeds - slowest.config.seeds)
    training = _seconds_an_epoch(slowest) * config.epochs * (1 + MORE_SEEDS * more)
    return training + ANALYSIS * len(missing(job))


def _seconds_an_epoch(run: Run) -> float:
    return float(run.last["seconds"] / run.last["epoch"])


def plan_sitting(jobs: Sequence[Job], minutes: float, timed: Sequence[Run]) -> Sitting:
    """Chooses the jobs of a sitting: those that take least time for each seed come first.

    Raises:
      UsageError: no job is missing, or none fits.
    """
    lacking = [(job, seconds_of(job, timed)) for job in jobs if not is_complete(job)]
    known = [(job, seconds) for job, seconds in lacking if seconds is not None]
    if not known:
        raise UsageError("no run is missing whose like is recorded from an accelerator; there is nothing to plan")
    fits: list[tuple[Job, float]] = []
    for job, seconds in sorted(known, key=lambda one: one[1] / one[0].config.seeds):
        size = RECORD_MIB * sum(other.config.seeds for other in (job, *(done for done, _ in fits)))
        if seconds + sum(spent for _, spent in fits) <= 60 * minutes and size <= FILE_MIB * FILES:
            fits.append((job, seconds))
    if not fits:
        shortest = min(seconds for _, seconds in known)
        raise UsageError(f"--minutes {minutes:g} is too short; the shortest run takes about {shortest / 60:.1f}")
    chosen = [job for job, _ in fits]
    return Sitting(minutes, fits, [(job, seconds) for job, seconds in lacking if job not in chosen])


def script(sitting: Sitting, words: Sequence[str], timed: Sequence[Run]) -> list[str]:
    """Returns the lines of a shell script: a command for each run, and the archives of their records.

    Args:
      sitting: the plan.
      words: the command `python -m experiments reproduce …`, to which each run is added.
      timed: the runs that the times are from.
    """
    lines = [
        f"# {sitting.seconds / 60:.1f} of {sitting.minutes:g} minutes, as long as such runs took on "
        f"{', '.join(dict.fromkeys(run.about['machine']['accelerator'] for run in timed))}."
    ]
    lines += [
        f"{shlex.join([*words, '--only', job.name])}  # about {seconds / 60:.1f} minutes"
        for job, seconds in sitting.fits
    ]
    archives: list[list[Job]] = [[]]
    for job, _ in sitting.fits:
        if archives[-1] and RECORD_MIB * sum(one.config.seeds for one in (*archives[-1], job)) > FILE_MIB:
            archives.append([])
        archives[-1].append(job)
    for number, archive in enumerate(archives, start=1):
        names = shlex.join(job.name for job in archive)
        size = RECORD_MIB * sum(job.config.seeds for job in archive)
        lines.append(f"tar czf records-{number}.tar.gz -C experiments/records {names}  # at most {size:.0f} MiB")
    return lines + [f"# Left: {job.name}, {_length(seconds)}." for job, seconds in sitting.left]


def _length(seconds: float | None) -> str:
    return "and nothing like it was timed" if seconds is None else f"about {seconds / 60:.1f} minutes"
