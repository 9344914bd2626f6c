"""The host loop of training: clock, terminal and disk around an epoch's two compiled programs.

Runs that differ in numbers only train side by side in one program; usually there is one run. The members of the
program's leading axis are the seeds of all runs, run by run.
"""

from __future__ import annotations

import secrets
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ear_jax.config import Config
from ear_jax.errors import RunError
from ear_jax.limits import check
from ear_jax.process.stopping import Stopped, StopRequest
from ear_jax.process.terminal import TrainingBar, phase, say
from ear_jax.runs import checkpoint, records, training
from ear_jax.runs.checkpoint import Step
from ear_jax.runs.compiled import Compiled, compile_program, fill_replay, train_epochs
from ear_jax.runs.directory import check_place, check_settings, check_tasks
from ear_jax.runs.documents import about, differences, header, rows_of
from ear_jax.runs.estimate import check_memory
from ear_jax.runs.failure import find_failure, reported
from ear_jax.runs.fastest import with_engine
from ear_jax.runs.history import FIRST, LOG, History, note_first_step, read_history, write_history
from ear_jax.runs.lock import lock_directory
from ear_jax.runs.on_host import collects_on_host, compile_on_host
from ear_jax.runs.seeds import seed_sharding
from ear_jax.runs.side_by_side import differing, join, members, of_run
from ear_jax.runs.tracking import tracking
from ear_jax.runs.training import Program, TrainState


@dataclass(frozen=True)
class Run:
    """A run to train."""

    config: Config
    directory: Path
    about: dict[str, Any] = field(default_factory=dict)  # the document of its config.json and checkpoints
    track: Callable[[list[dict[str, Any]]], None] = lambda _: None  # copies rows of metrics elsewhere
    rows: list[str] = field(default_factory=list)  # lines of its metrics.jsonl, to which training adds


@dataclass(frozen=True)
class Progress:
    """The point that runs training side by side have reached."""

    histories: list[History]  # of each run
    steps: list[Step]  # of each run, of one epoch; empty before the first
    epoch: int

    @property
    def seconds(self) -> float:
        """The seconds trained until then."""
        return max(history.seconds for history in self.histories) if self.steps else 0.0


def train_run(config: Config, directory: Path) -> None:
    """Trains a run to its end, or continues it.

    Args:
      config: the run's settings.
      directory: the run's directory. An unfinished run there continues from its newest good checkpoint; for a finished
        one nothing is done.

    Raises:
      UsageError: the configuration is invalid, or differs from that of the run in `directory`.
      RunError: the run cannot be trained here, or a metric is not finite.
      Stopped: a signal stopped the run after it saved.
    """
    train_runs([Run(config, directory)])


def train_runs(runs: Sequence[Run]) -> None:
    """Trains runs side by side, as `train_run` does; one that fails does not stop the others.

    Args:
      runs: differ in nothing but the `NUMBERS` of `runs/side_by_side.py`.
    """
    began = time.perf_counter()
    for run in runs:
        check(run.config)
        check_place(run.directory)
    program = training.make_program(with_engine(members([run.config for run in runs]), say))
    on_host = collects_on_host(program)
    progress = _progress(runs, program, say)
    if progress.steps and _finished(program.config, progress.epoch, progress.seconds):
        done = f"{progress.epoch} epochs, {progress.seconds / 60:.1f} minutes"
        say(f"{_place(runs)} is finished: {done} (raise --epochs or --minutes for more)")
        for run, history in zip(runs, progress.histories, strict=True):
            if history.damaged:
                with lock_directory(run.directory, say):
                    write_history(run.directory, history.settings, history.rows)
        return
    check_memory(program)
    with ExitStack() as held:
        for run in runs:
            held.enter_context(lock_directory(run.directory, say))
        request = held.enter_context(StopRequest(say))
        progress = _progress(runs, program, _ignore)  # another process may have trained meanwhile
        started = bool(progress.steps)
        runs = [_prepare(run, program, past, started) for run, past in zip(runs, progress.histories, strict=True)]
        runs = [replace(run, track=held.enter_context(tracking(run.directory, run.config, say))) for run in runs]
        say(header(replace(program, config=runs[0].config), _place(runs)))
        keys = jnp.concatenate([training.seed_keys(run.config) for run in runs])
        with phase("compiling"):
            compiling = compile_on_host if on_host else compile_program
            compiled = compiling(program, keys, differing([run.config for run in runs]))
        state = _restore(program, compiled, keys, progress) if progress.steps else _begin(program, compiled, keys)
        _train_blocks(
            program, runs, compiled, state, keys, lambda: progress.seconds + time.perf_counter() - began, request
        )


def _place(runs: Sequence[Run]) -> str:
    """Names where runs are."""
    first = runs[0].directory
    return str(first) if len(runs) == 1 else f"{first.parent} ({len(runs)} runs side by side)"


def _prepare(run: Run, program: Program, history: History, started: bool) -> Run:
    """Writes what the run's directory should hold before it trains on, and returns the run with its past.

    For a continued run config.json keeps what it tells of the start, and gets the settings, which may name more epochs.
    """
    document, past = about(program, run.config), history.settings
    document["run"] = past.get("run") or secrets.token_hex(8)
    first = past.get(FIRST) or history.step.epoch if started and history.step else None
    rows = history.rows if started else ""
    checkpoint.clean(run.directory / checkpoint.FOLDER)
    write_history(run.directory, {**document, **past, "config": document["config"], FIRST: first}, rows)
    return replace(run, about=document, rows=[rows])


def _check_first_save(runs: Sequence[Run]) -> None:
    """Raises RunError if runs have trained past the first save, and one of them has lost its checkpoints."""
    saved = [(len(checkpoint.steps(run.directory / "checkpoints")), run.directory) for run in runs]
    if max(saved)[0] > 1:
        raise RunError(f"{min(saved)[1]} has no checkpoints, unlike {max(saved)[1]} that trained beside it")


def _ignore(_: str) -> None:
    """Says nothing."""


def _progress(runs: Sequence[Run], program: Program, warn: Callable[[str], None]) -> Progress:
    """Returns the newest good step of each run at the newest epoch of which all have one."""
    steps, until = [], None
    while True:
        histories = [read_history(run.directory, warn, until) for run in runs]
        warn = _ignore  # the same damage again
        steps = [history.step for history in histories if history.step]
        until = min((step.epoch for step in steps), default=0)
        if len(steps) < len(runs) or all(step.epoch == until for step in steps):
            break
    if len(steps) < len(runs):
        _check_first_save(runs)
        steps, until = [], 0
    for run, history in zip(runs, histories, strict=True):
        if history.settings:
            _check_same(run.directory, history.settings, run.config, program)
    for run, step in zip(runs, steps, strict=False):
        _check_same(step.path, step.about, run.config, program)
    return Progress(histories, steps, until)


def _begin(program: Program, compiled: Compiled, keys: jax.Array) -> TrainState:
    with phase("collecting with the untrained policy"):
        return fill_replay(compiled, compiled.init(keys), program.config.collect.pretrain_epochs)


def _restore(program: Program, compiled: Compiled, keys: jax.Array, progress: Progress) -> TrainState:
    """Restores the runs' steps; a replay that was not saved is refilled with the current policy."""
    steps, epoch = progress.steps, progress.epoch
    for line in dict.fromkeys(line for step in steps for line in differences(step.about, program)):
        say(f"warning: {line}: results may differ in the last bit")
    saved = all(step.about["replay"] for step in steps)
    like = compiled.state if saved else compiled.state.without_replay
    with phase(f"restoring epoch {epoch}"):
        state: TrainState = join(
            [checkpoint.restore(step, of_run(like, index, len(steps))) for index, step in enumerate(steps)]
        )
        if saved:
            state = jax.device_put(state, seed_sharding(len(keys)))
            return state
    epochs = program.config.collect.pretrain_epochs
    say(
        f"warning: epoch {epoch} was saved without its replay; {epochs} epochs of collection "
        f"({program.env_steps(epochs):,} env steps per seed) refill it, so results will differ from an unbroken run"
    )
    empty = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), compiled.state.replay)
    with phase("collecting with the current policy"):
        state = jax.device_put(replace(state, replay=empty), seed_sharding(len(keys)))
        return fill_replay(compiled, state, epochs)


def _train_blocks(
    program: Program,
    runs: Sequence[Run],
    compiled: Compiled,
    state: TrainState,
    keys: jax.Array,
    clock: Callable[[], float],
    request: StopRequest,
) -> None:
    """Trains block by block until the end or a stop; each block is evaluated, recorded and maybe saved."""
    config = program.config
    epoch, blocks = int(state.epoch[0]), 0
    last = _finished(config, epoch, clock()) or request.signal is not None
    if last and request.signal is None and epoch < config.epochs:
        raise RunError(f"--minutes {config.minutes:g} ran out before training started; raise it to continue")
    with TrainingBar(epoch, config.epochs) as bar:
        while not last:
            block_began = time.perf_counter()
            count = min(config.log.epochs, config.epochs - epoch)
            state, metrics = train_epochs(compiled, state, count)
            epoch, blocks = epoch + count, blocks + 1
            episodes = compiled.evaluate(state.learner.policy, training.evaluation_keys(keys, epoch))
            metrics, episodes = jax.device_get((metrics, episodes))  # waits for the device, once per block
            block_seconds = time.perf_counter() - block_began
            finite = sum(epoch_metrics.pop("finite_updates") for epoch_metrics in metrics)  # [members, tasks]
            rows = rows_of(program, state, clock(), metrics, episodes)
            for index, run in enumerate(runs):
                own = slice(index * run.config.seeds, (index + 1) * run.config.seeds)
                named = [{"seed": run.config.seed + number, **row} for number, row in enumerate(rows[own])]
                _record(run, named, finite[own], (epoch - count) * config.sac.updates, alone=len(runs) == 1)
            if all(reported(run.directory) for run in runs):
                raise RunError("all runs failed")
            last = _finished(config, epoch, clock()) or request.signal is not None
            if last or blocks % config.checkpoint.blocks == 0:
                for index, run in enumerate(runs):
                    _save(run, of_run(state, index, len(runs)), last)
            steps, updates = count * program.env_steps_per_epoch, count * config.sac.updates
            mean_return = float(np.mean(episodes.returns))
            steps_rate, updates_rate = (config.seeds * number / block_seconds for number in (steps, updates))
            bar.update(epoch, mean_return, steps_rate, updates_rate)
    if request.signal is not None:
        say(f"stopped at epoch {epoch}; the same command continues")
        raise Stopped(request.signal)


def _record(run: Run, rows: list[dict[str, Any]], finite: np.ndarray, before: int, alone: bool) -> None:
    """Writes a block's rows; a run whose metrics are not finite ends, unless others train beside it."""
    if not alone and reported(run.directory):
        return
    failure = find_failure(run.directory, rows, finite, before)
    if failure and alone:
        raise RunError(f"{failure}; checkpoints are unchanged, and the same command would fail again")
    if failure:
        say(f"warning: {failure}; the other runs go on")
    else:
        run.rows.append(records.append_rows(run.directory / LOG, rows))
        run.track(rows)


def _save(run: Run, state: TrainState, last: bool) -> None:
    """Saves a step; a failure ends the run only at its last step, as a full disk may have room again by the next."""
    kept, epoch = state if run.about["replay"] else state.without_replay, int(state.epoch[0])
    try:
        checkpoint.save(run.directory / checkpoint.FOLDER, epoch, kept, run.about, "".join(run.rows))
        note_first_step(run.directory, epoch)
    except RunError as error:
        if last:
            raise RunError(f"{error}; the same command continues from the previous checkpoint") from error
        say(f"warning: {error}; training continues")


def _finished(config: Config, epoch: int, seconds: float) -> bool:
    return epoch >= config.epochs or (config.minutes is not None and seconds >= 60 * config.minutes)


def _check_same(holder: Path, document: dict[str, Any], config: Config, program: Program) -> None:
    check_settings(holder, document, config)
    check_tasks(holder, document, program.tasks)
