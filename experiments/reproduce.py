"""Runs what is missing of a table or figure, each step an `ear` command in a process of its own."""

from __future__ import annotations

import json
import re
import shlex
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from types import FrameType

from ear_jax.config import from_dict, run_name
from ear_jax.errors import RunError, UsageError
from ear_jax.process.stopping import Stopped
from ear_jax.process.terminal import say
from ear_jax.runs import records
from ear_jax.runs.lock import InUse, lock_directory
from experiments import inventory
from experiments.commands import RUNS, analysis_words, export_words, is_copied, train_words
from experiments.inventory import POLICY, Job, is_kept, is_whole, missing
from experiments.paper import Analysis

IN_HAND = ".reproduce"  # where a process locks the jobs that it is at, so that several can share a table


def plan(job: Job) -> list[str]:
    """The command lines that would make a job whole."""
    if is_whole(job):
        return []
    run, record = RUNS / job.name, inventory.RECORDS / job.name
    training = [] if is_kept(job) else [train_words(job), export_words(run, record)]
    return [shlex.join(["ear", *words]) for words in (*training, *(analysis_words(job, one) for one in missing(job)))]


def make_whole(job: Job) -> bool:
    """Trains a job and analyses it, as far as that has not been done and no other process is at it.

    Returns:
      Whether it is whole: another process may have it in hand, and it is left to that.

    Raises:
      RunError, Stopped: as `run_ear`; what has been done stays, and the next call goes on from there.
    """
    if is_whole(job):
        return True
    try:
        with lock_directory(RUNS / IN_HAND / job.name, lambda _: None):
            for line in plan(job):
                say(line)
            if not is_kept(job):
                run_ear(train_words(job))
                keep(RUNS / job.name, anew=True)
            for analysis in missing(job):
                analyse(job, analysis)
    except InUse:
        say(f"{job.name} is left to another process, which is at it")
        return False
    return True


def analyse(job: Job, analysis: Analysis) -> None:
    """Adds an analysis to the record of a job; raises as `run_ear`."""
    words = analysis_words(job, analysis)
    document = json.loads(run_ear(words))
    if analysis.picture:
        shutil.copyfile(document["files"][analysis.picture], job.record / f"{analysis.name}.png")
    command = shlex.join(["ear", *words])
    records.write_json(job.record / f"{analysis.name}.json", {**document, "command": command, **records.provenance()})


def keep(run: Path, name: str | None = None, anew: bool = False) -> Path:
    """Makes a record of a run, of all its seeds together.

    Args:
      run: its directory.
      name: the record's; by default that of a run with these family, agent, preset and seeds.
      anew: whether a record of another run of that name gives way, and with it what was found out of that.

    Raises:
      UsageError: it is no run directory, a name that is none, or another run is recorded under it.
      RunError: it has no metrics, or nothing to export.
      Stopped: as `run_ear`.
    """
    name = name or run_name(from_dict(records.read_run(run)["config"]))
    if not re.fullmatch(r"[a-z0-9][a-z0-9.+-]*", name):
        raise UsageError(f"--name {name} cannot name a record; use small letters, digits, -, + and .")
    record = inventory.RECORDS / name
    if not (run / "metrics.jsonl").is_file():
        raise RunError(f"{run} has no metrics yet; the record stays as it is")
    if not is_copied(run, record):
        if (record / "metrics.jsonl").exists() and not anew:
            raise UsageError(f"{record} is of another run; give this one a --name, or remove that first")
        shutil.rmtree(record, ignore_errors=True)
    record.mkdir(parents=True, exist_ok=True)
    (record / POLICY).unlink(missing_ok=True)  # of a process that was stopped while it wrote
    run_ear(export_words(run, record))
    for name in ("config.json", "metrics.jsonl"):  # by which it counts
        shutil.copyfile(run / name, record / name)
    return record


def run_ear(words: list[str]) -> str:
    """Runs an `ear` command with its messages on our stderr, and returns its stdout.

    Raises:
      Stopped: we were asked to stop, and so was it.
      RunError: it failed.
    """
    child = subprocess.Popen([sys.executable, "-m", "ear_jax.cli.main", *words], stdout=subprocess.PIPE, text=True)

    asked: list[int] = []

    def wait_for_it(number: int, frame: FrameType | None) -> None:
        asked.append(number)
        if number == signal.SIGTERM:  # Ctrl-C reaches it by itself
            child.terminate()

    before = {number: signal.signal(number, wait_for_it) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        output, _ = child.communicate()
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    if asked:
        raise Stopped(asked[0])
    if child.returncode:
        raise RunError(f"`{shlex.join(['ear', *words])}` ended with exit code {child.returncode}")
    return output
