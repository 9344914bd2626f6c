"""Runs as tasks of a Ray cluster (extra `cluster`), each an `ear` command of its own, with one table of their progress.

The nodes share the directory of the runs, and the environment of Python. A task that loses its node is started again on
another one, where its command continues the run from its checkpoint.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.live import Live
from rich.table import Table

from ear_jax.errors import RunError, first_line, plain
from ear_jax.files.rows import last_row
from ear_jax.process.environment import THEIRS
from ear_jax.process.stopping import PARENT, Stopped, StopRequest
from ear_jax.process.terminal import console, is_live, say

RETRIES = 20  # of a task whose node or worker dies
LOCK_SECONDS = 180  # until a lock that a dead node held is given up by the file system
EVERY = 1.0  # second the table is drawn


@dataclass(frozen=True)
class Job:
    """A command that trains or continues a run."""

    name: str
    words: tuple[str, ...]  # after `python -m`
    run: Path  # the run's directory
    epochs: int


def run_jobs(jobs: Sequence[Job], logs: Path, cores: int) -> dict[str, str]:
    """Carries out jobs on the cluster, and shows their progress until all have ended.

    A stop signal stops all of them, each after its block, so that nothing runs on.

    Args:
      jobs: at least one.
      logs: the directory of what the commands say, a file for each job.
      cores: of each job, where the cluster has no GPUs; else a job has one GPU.

    Returns:
      By the name of each job that failed, the last line that it said.

    Raises:
      RunError: Ray is not installed or cannot be reached.
      Stopped: a signal stopped the jobs.
    """
    ray = load_ray()
    logs.mkdir(parents=True, exist_ok=True)
    with _connected(ray) as resources, StopRequest(say) as request:
        _check_resources(resources, cores)
        wanted = {"num_cpus": 0, "num_gpus": 1} if resources.get("GPU") else {"num_cpus": cores}
        task = ray.remote(max_retries=RETRIES, **wanted)(_carry_out)
        tasks = {}
        for job in jobs:
            log = (logs / f"{job.name}.log").absolute()
            where = {"directory": os.getcwd(), "log": str(log), "lock": str((job.run / "lock").absolute())}
            tasks[task.remote(job.words, _variables(), where, LOCK_SECONDS)] = job
        ends = _follow(ray, tasks, request)
    if request.signal is not None:
        say("all runs are stopped; the same command continues them")
        raise Stopped(request.signal)
    return {name: reason for name, reason in ends.items() if reason}


def check(failed: Mapping[str, str], logs: Path) -> None:
    """Raises RunError if jobs failed, with what each said last."""
    if failed:
        reasons = "; ".join(f"{name}: {reason}" for name, reason in failed.items())
        raise RunError(f"{len(failed)} runs failed: {reasons} (all they said is in {logs})")


def load_ray() -> Any:
    """Returns Ray; raises RunError, with the way to install it, if it is missing."""
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # it would report to its makers
    os.environ.setdefault("RAY_worker_niceness", "0")  # of a cluster that is started here; Ray's own is 15
    try:
        import ray
    except ImportError:
        raise RunError("--on ray needs Ray, of the extra cluster: pip install 'ear-jax[cluster]'") from None
    ray.cloudpickle.register_pickle_by_value(sys.modules[__name__])  # workers need not import this package
    return ray


@contextmanager
def _connected(ray: Any) -> Iterator[Mapping[str, float]]:
    """A context that is connected to the cluster, that of RAY_ADDRESS or of this machine, or else to a new one here."""
    try:
        ray.init(log_to_driver=False, logging_level="error", include_dashboard=False, configure_logging=True)
    except Exception as error:
        raise RunError(f"Ray cannot start or be reached: {first_line(error)}") from None
    try:
        yield ray.cluster_resources()
    finally:
        ray.shutdown()


def _check_resources(resources: Mapping[str, float], cores: int) -> None:
    if not resources.get("GPU") and cores > resources.get("CPU", 0):
        raise RunError(f"--cores {cores} is more than the {resources.get('CPU', 0):g} cores of the whole cluster")


def _variables() -> dict[str, str]:
    """Returns the variables that a command needs of this process."""
    own = {name: value for name, value in os.environ.items() if name.startswith(("EAR_JAX_", *THEIRS))}
    own.pop(PARENT, None)
    own.pop("CUDA_VISIBLE_DEVICES", None)  # Ray sets it
    return {**own, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}


def _carry_out(
    words: Sequence[str], variables: Mapping[str, str], where: Mapping[str, str], patience: float
) -> tuple[int, str]:
    """Runs a command on a node; returns its exit code and the last line that it said.

    A command that is killed by itself, as for want of memory, is started again twice. One whose worker is cancelled
    stops after its block, and one whose worker is killed is killed with it.
    """
    import fcntl
    import signal
    import subprocess

    os.chdir(where["directory"])
    until = time.monotonic() + patience
    while os.path.exists(where["lock"]) and time.monotonic() < until:  # a node that died may still hold it
        with open(where["lock"], "r+b") as lock:  # NFS locks only what is open for writing
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                time.sleep(0.5)
            except OSError:  # no locks here, so none is held
                break
    environment = {**os.environ, **variables, PARENT: str(os.getpid())}
    code: int | None = -signal.SIGKILL
    for _ in range(3):
        with open(where["log"], "ab") as log:
            child = subprocess.Popen(
                [sys.executable, "-m", *words], env=environment, stdout=log, stderr=log, stdin=subprocess.DEVNULL
            )
        try:
            while (code := child.poll()) is None:
                time.sleep(0.1)
        finally:
            if child.poll() is None:
                child.terminate()
                child.wait()
        if code is not None and code >= 0:
            break
        time.sleep(5)  # if the node is dying, this worker ends within that time
    with open(where["log"], "rb") as log:
        lines = log.read().decode(errors="replace").split("\n")
    return code or 0, next((line for line in reversed(lines) if line.strip()), "")


def _follow(ray: Any, tasks: dict[Any, Job], request: StopRequest) -> dict[str, str]:
    """Waits for tasks and shows their progress; returns by job why it failed, empty for those that did not."""
    waiting, ends = dict(tasks), {}
    cancelled = False
    with Live(console=console, auto_refresh=False, transient=False) if is_live() else nullcontext() as shown:
        while waiting:
            done, _ = ray.wait(list(waiting), num_returns=len(waiting), timeout=EVERY)
            for task in done:
                job = waiting.pop(task)
                ends[job.name] = _end(ray, task)
                if not is_live() and not cancelled:
                    say(f"{job.name}: {ends[job.name] or 'done'} ({len(ends)} of {len(tasks)})")
            if request.signal is not None and not cancelled:
                cancelled = True
                for task in waiting:
                    ray.cancel(task, force=False)
            if shown is not None:
                shown.update(table(list(tasks.values()), ends), refresh=True)
    if shown is None:
        console.print(table(list(tasks.values()), ends))
    return ends


def _end(ray: Any, task: Any) -> str:
    """Returns why a task failed, or nothing."""
    try:
        code, line = ray.get(task)
    except ray.exceptions.TaskCancelledError:
        return "stopped"
    except ray.exceptions.RayError as error:
        return first_line(error)
    return line or f"exit code {code}" if code else ""


def table(jobs: Sequence[Job], ends: Mapping[str, str]) -> Table:
    """Returns the progress of all runs: epochs, return, minutes, and the process that trains each.

    Args:
      jobs: all of them.
      ends: of those that have ended, why they failed, or nothing.
    """
    shown = Table()
    for heading in ("run", "epochs", "return", "minutes", "state"):
        shown.add_column(heading, overflow="fold")
    for job in jobs:
        row = last_row(job.run / "metrics.jsonl") or {}
        epochs = f"{row.get('epoch', 0)}/{job.epochs}"
        numbers = (f"{row['mean_return']:.1f}", f"{row['seconds'] / 60:.1f}") if row else ("", "")
        state = (ends[job.name] or "done") if job.name in ends else _holder(job.run) or "waiting"
        shown.add_row(*map(plain, (job.name, epochs, *numbers, state)))
    return shown


def _holder(run: Path) -> str:
    """Returns the process that trains a run, as its lock names it."""
    try:
        return (run / "lock").read_text(errors="replace").strip()
    except OSError:
        return ""
