"""Runs what is missing of a table or figure; each step is an `ear` command in a process of its own."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import FrameType

from ear_jax.config import from_dict, run_name
from ear_jax.errors import RunError, UsageError
from ear_jax.files.replacing import copy_file, lock_file
from ear_jax.process.stopping import Stopped, child_environment, stop_signals
from ear_jax.process.terminal import say
from ear_jax.runs import on_ray, records
from ear_jax.runs.lock import InUse, lock_directory
from experiments import inventory
from experiments.commands import IN_HAND, RUNS, analysis_words, export_words, is_copied, train_words
from experiments.inventory import Job, is_complete, is_kept, missing
from experiments.paper import Analysis

PAUSE = 2.0  # seconds


def plan(job: Job) -> list[str]:
    """Returns the command lines that complete a job."""
    if is_complete(job):
        return []
    run, record = RUNS / job.name, inventory.RECORDS / job.name
    training = [] if is_kept(job) else [train_words(job), export_words(run, record)]
    return [
        shlex.join(["ear", *words])
        for words in (*training, *(analysis_words(job, analysis) for analysis in missing(job)))
    ]


def complete(job: Job) -> bool:
    """Trains and analyses a job, as far as this has not been done and no other process is working on it.

    Returns:
      Whether the job is complete; False if it is left to another process.

    Raises:
      RunError, Stopped: as `run_ear`; finished steps stay, and the next call continues from there.
    """
    if is_complete(job):
        return True
    try:
        with lock_directory(RUNS / IN_HAND / job.name, lambda _: None) as claim:
            os.set_inheritable(claim, True)  # for the commands of `run_ear`: the claim outlives this process with them
            for line in plan(job):
                say(line)
            if not is_kept(job):
                run_ear(train_words(job))
                keep(RUNS / job.name, replace=True)
            for analysis in missing(job):
                analyse(job, analysis)
    except InUse:
        return False
    return True


def complete_all(jobs: list[Job]) -> None:
    """Completes jobs; the last ones may be in the hands of other processes, and are taken over if these end.

    Raises:
      RunError, Stopped: as `run_ear`; finished steps stay, and the next call continues from there.
    """
    left = [job for job in jobs if not complete(job)]
    if left:
        say(f"waiting for other processes, which are working on {', '.join(job.name for job in left)}")
    while left := [job for job in left if not complete(job)]:
        pause()


def complete_on_ray(jobs: list[Job], words: list[str], cores: int) -> None:
    """Completes each job as a task of a Ray cluster; raises RunError if some fail.

    Args:
      jobs: those of a table or figure.
      words: the command line of `python -m experiments` that means them.
      cores: of each job.
    """
    tasks = [
        on_ray.Job(job.name, ("experiments", *words, "--only", job.name), RUNS / job.name, job.config.epochs)
        for job in jobs
        if not is_complete(job)
    ]
    if tasks:
        logs = RUNS / IN_HAND / "logs"
        on_ray.check(on_ray.run_jobs(tasks, logs, cores), logs)


def pause() -> None:
    """Waits before the next look at whether other processes are still working."""
    time.sleep(PAUSE)


def analyse(job: Job, analysis: Analysis) -> None:
    """Adds an analysis to the record of a job; raises as `run_ear`."""
    words = analysis_words(job, analysis)
    if analysis.writes:
        (job.record / analysis.writes).unlink(missing_ok=True)  # of a process that was killed before its document
    document = json.loads(run_ear(words))
    if analysis.picture:
        copy_file(Path(document["files"][analysis.picture]), job.record / f"{analysis.name}.png")
    command = shlex.join(["ear", *words])
    records.write_json(job.record / f"{analysis.name}.json", {**document, "command": command, **records.provenance()})


def keep(run: Path, name: str | None = None, replace: bool = False) -> Path:
    """Makes a record of a run with all its seeds, whole or not at all.

    The same run is recorded again with its analyses, and another one without those of the run before.

    Args:
      run: the run directory.
      name: the record's name; by default from family, agent, preset and seeds.
      replace: replaces a record of another run under that name, with its analyses.

    Raises:
      UsageError: not a run directory, an invalid name, or another run is recorded under the name.
      RunError: the run has no metrics, damaged ones, or nothing to export.
      Stopped: as `run_ear`.
    """
    name = name or run_name(from_dict(records.read_run(run)["config"]))
    if not re.fullmatch(r"[a-z0-9][a-z0-9.+-]*", name):
        raise UsageError(f"--name {name} cannot name a record; use lower-case letters, digits, -, + and .")
    record = inventory.RECORDS / name
    if not (run / "metrics.jsonl").is_file():
        raise RunError(f"{run} has no metrics yet; nothing was recorded")
    records.read_rows(run / "metrics.jsonl")  # raises for damaged ones
    with lock_file(RUNS / IN_HAND / name):
        same = is_copied(run, record)
        if not same and (record / "metrics.jsonl").exists() and not replace:
            raise UsageError(f"{record} records another run; choose another --name, or remove that record first")
        fresh, old = (record.with_name(f".{name}.{kind}") for kind in ("part", "old"))
        for leftover in (fresh, old):  # of processes that were killed
            shutil.rmtree(leftover, ignore_errors=True)
        fresh.mkdir(parents=True)
        try:
            run_ear(export_words(run, fresh))
            for file in ("config.json", "metrics.jsonl"):
                copy_file(run / file, fresh / file)
            if same:
                for path in fresh.iterdir():
                    os.replace(path, record / path.name)
            else:
                if record.exists():
                    os.replace(record, old)
                os.replace(fresh, record)
        finally:
            shutil.rmtree(fresh, ignore_errors=True)
        shutil.rmtree(old, ignore_errors=True)
    return record


def run_ear(words: list[str]) -> str:
    """Runs an `ear` command with its messages on our stderr, and returns its stdout.

    If this process is killed, the command stops as by SIGTERM.

    Raises:
      Stopped: this process was asked to stop; the command was stopped too.
      RunError: the command failed.
    """
    line = [sys.executable, "-m", "ear_jax.cli.main", *words]
    child = subprocess.Popen(line, stdout=subprocess.PIPE, text=True, env=child_environment(), close_fds=False)
    signals: list[int] = []

    def pass_on(number: int, frame: FrameType | None) -> None:
        signals.append(number)
        if number != signal.SIGINT:  # Ctrl-C reaches the child directly
            child.send_signal(number)

    before = {number: signal.signal(number, pass_on) for number in stop_signals()}
    try:
        output, _ = child.communicate()
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    if signals:
        raise Stopped(signals[0])
    if child.returncode:
        raise RunError(f"`{shlex.join(['ear', *words])}` ended with exit code {child.returncode}")
    return output
