"""The host loop of training: clock, terminal and disk around an epoch's two compiled programs.

Runs that differ in numbers only train side by side in one program; usually there is one run. The members of the
program's leading axis are the seeds of all runs, run by run.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ear_jax.config import Config, from_dict
from ear_jax.errors import RunError
from ear_jax.limits import check
from ear_jax.process import hosts
from ear_jax.process.stopping import Stopped, StopRequest
from ear_jax.process.terminal import TrainingBar, phase, say
from ear_jax.runs import checkpoint, records, training
from ear_jax.runs.compiled import Compiled, fill_replay, train_epochs
from ear_jax.runs.directory import check_place
from ear_jax.runs.documents import differences, header, rows_of
from ear_jax.runs.estimate import check_memory
from ear_jax.runs.failure import Diverged, find_failure, forget
from ear_jax.runs.fastest import with_engine
from ear_jax.runs.history import LOG, note_first_step, read_history, write_history
from ear_jax.runs.lock import lock_directory
from ear_jax.runs.on_host import compiler_of
from ear_jax.runs.seeds import check_seeds, own_members, seed_sharding
from ear_jax.runs.side_by_side import differing, join, keys_of, members, of_run, over_hosts
from ear_jax.runs.starting_point import Progress, Run, agreed, given_up, ignore, prepare, reached
from ear_jax.runs.tracking import tracking
from ear_jax.runs.training import Program, TrainState

__all__ = ["Run", "train_run", "train_runs"]


def train_run(config: Config, directory: Path | str) -> None:
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
    train_runs([Run(from_dict(asdict(config)), Path(directory))])  # which checks the types


def train_runs(runs: Sequence[Run]) -> None:
    """Trains runs side by side, as `train_run` does; one that fails does not stop the others.

    Args:
      runs: differ in nothing but the `NUMBERS` of `runs/side_by_side.py`.
    """
    began = time.perf_counter()
    for run in runs:
        check(run.config)
        check_place(run.directory)
    program = _program([run.config for run in runs])
    compiling = compiler_of(program)
    progress = agreed(lambda: reached(runs, program, say))
    if progress.steps and _finished(program.config, progress.epoch, progress.seconds):
        done = f"{progress.epoch} epochs, {progress.seconds / 60:.1f} minutes"
        say(f"{_place(runs)} is finished: {done} (raise --epochs or --minutes for more)")
        for run, history in zip(runs, progress.histories, strict=False):
            if history.damaged:
                _repair(run.directory)
        return
    check_memory(program)
    with ExitStack() as held:
        request = held.enter_context(StopRequest(say))
        runs, progress = _open(runs, program, held)
        say(header(replace(program, config=runs[0].config), _place(runs)))
        keys = keys_of([run.config for run in runs])
        with phase("compiling"):
            compiled = compiling(program, keys, differing([run.config for run in runs]))
        state = _restore(program, compiled, keys, progress) if progress.steps else _begin(program, compiled, keys)
        _train_blocks(
            program, runs, compiled, state, keys, lambda: progress.seconds + time.perf_counter() - began, request
        )


def _program(configs: Sequence[Config]) -> Program:
    """Returns the program that trains runs side by side."""
    config = members(configs)
    check_seeds(config.seeds)
    return training.make_program(config if hosts.count() > 1 else with_engine(config, say))


def _open(runs: Sequence[Run], program: Program, held: ExitStack) -> tuple[list[Run], Progress]:
    """Locks and prepares the directories of runs; returns the runs with their past, and the point they have reached."""
    opened = list(runs)

    def find() -> Progress:
        for run in runs:
            held.enter_context(lock_directory(run.directory, say))
        progress = reached(runs, program, ignore)  # another process may have trained meanwhile
        started = bool(progress.steps)
        for index, (run, out, past) in enumerate(zip(runs, given_up(runs), progress.histories, strict=True)):
            if out:
                continue
            run = prepare(run, program, past, started)
            opened[index] = replace(run, track=held.enter_context(tracking(run.directory, run.config, say)))
        if len(runs) == 1:
            forget(runs[0].directory)
        return progress

    return opened, agreed(find)


def _repair(directory: Path) -> None:
    """Restores the documents of a run, as they are once no other process has it."""
    with lock_directory(directory, say):
        history = read_history(directory, ignore)
        if history.damaged:
            write_history(directory, history.settings, history.rows)


def _place(runs: Sequence[Run]) -> str:
    """Names where runs are."""
    first = runs[0].directory
    return str(first) if len(runs) == 1 else f"{first.parent} ({len(runs)} runs side by side)"


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
    sharding = seed_sharding(len(keys))
    with phase(f"restoring epoch {epoch}"):
        state: TrainState = join(
            [
                checkpoint.restore(step, of_run(like, index, len(steps)), sharding=over_hosts(len(keys) // len(steps)))
                for index, step in enumerate(steps)
            ],
            sharding,
        )
        if saved:
            return state
    epochs = program.config.collect.pretrain_epochs
    say(
        f"warning: epoch {epoch} was saved without its replay; {epochs} epochs of collection "
        f"({program.env_steps(epochs):,} env steps per seed) refill it, so results will differ from an unbroken run"
    )
    empty = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype, device=sharding), compiled.state.replay)
    with phase("collecting with the current policy"):
        return fill_replay(compiled, replace(state, replay=empty), epochs)


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
    epoch, blocks = int(own_members(state.epoch)[0]), 0
    last, signal = hosts.agree(lambda: _before_training(config, epoch, clock(), request.signal))
    with TrainingBar(epoch, config.epochs) as bar:
        while not last:
            block_began = time.perf_counter()
            count = min(config.log.epochs, config.epochs - epoch)
            state, metrics = train_epochs(compiled, state, count)
            epoch, blocks = epoch + count, blocks + 1
            episodes = compiled.evaluate(state.learner.policy, training.evaluation_keys(keys, epoch))
            metrics, episodes = own_members((metrics, episodes))  # waits for the device, once per block
            block_seconds = time.perf_counter() - block_began
            finite = sum(epoch_metrics.pop("finite_updates") for epoch_metrics in metrics)  # [own members, tasks]
            rows = rows_of(program, own_members(state.collected), epoch, clock(), metrics, episodes)
            of_hosts = hosts.gather([rows, finite.tolist(), request.signal])
            close = partial(_close_block, runs, config, of_hosts, epoch - count, clock, request)
            last, signal, going, mean_return, fault = hosts.agree(close)
            if fault:
                raise Diverged(fault)
            if last or blocks % config.checkpoint.blocks == 0:
                for index in going:
                    _save(runs[index], of_run(state, index, len(runs)), epoch, last)
            steps, updates = count * program.env_steps_per_epoch, count * config.sac.updates
            steps_rate, updates_rate = (config.seeds * number / block_seconds for number in (steps, updates))
            bar.update(epoch, mean_return, steps_rate, updates_rate)
    if signal is not None:
        say(f"stopped at epoch {epoch}" + (", the last" if epoch == config.epochs else "; the same command continues"))
        raise Stopped(signal)


def _before_training(config: Config, epoch: int, seconds: float, signal: int | None) -> tuple[bool, int | None]:
    """Returns whether there is nothing to train, and the signal that stopped it before it began."""
    last = _finished(config, epoch, seconds) or signal is not None
    if last and signal is None and epoch < config.epochs:
        raise RunError(f"--minutes {config.minutes:g} ran out before training started; raise it to continue")
    return last, signal


def _close_block(
    runs: Sequence[Run],
    config: Config,
    of_hosts: list[list[Any]],
    before: int,
    clock: Callable[[], float],
    request: StopRequest,
) -> tuple[bool, int | None, list[int], float, str | None]:
    """Records a block's rows, by process 0.

    Args:
      runs: the runs side by side.
      config: of their program.
      of_hosts: rows, counts of finite updates [members, tasks] and signal of each host.
      before: the epochs before the block.
      clock: returns the seconds trained.
      request: the signal of this process.

    Returns:
      Whether it is the last block, the signal that makes it so, the indices of the runs that go on, their mean return,
      and a line if none goes on.
    """
    rows = [row for of_host in of_hosts for row in of_host[0]]
    finite = np.array([counts for of_host in of_hosts for counts in of_host[1]])
    for index, (run, out) in enumerate(zip(runs, given_up(runs), strict=True)):
        if out:
            continue
        own = slice(index * run.config.seeds, (index + 1) * run.config.seeds)
        named = [{"seed": run.config.seed + number, **row} for number, row in enumerate(rows[own])]
        failure = _record(run, named, finite[own], before * config.sac.updates)
        if failure and len(runs) == 1:
            fault = f"{failure}; checkpoints are unchanged, and the same command would fail again"
            return True, None, [], 0.0, fault
        if failure:
            say(f"warning: {failure}; the other runs go on")
    going = [index for index, out in enumerate(given_up(runs)) if not out]
    if not going:
        return True, None, [], 0.0, "all runs failed"
    returns = np.array([row["mean_return"] for row in rows]).reshape(len(runs), -1)
    signals = [request.signal, *(of_host[2] for of_host in of_hosts)]
    signal = next((number for number in signals if number is not None), None)
    last = _finished(config, rows[0]["epoch"], clock()) or signal is not None
    return last, signal, going, float(returns[going].mean()), None


def _record(run: Run, rows: list[dict[str, Any]], finite: np.ndarray, before: int) -> str | None:
    """Writes a block's rows; returns a line instead if some of its metrics are not finite."""
    failure = find_failure(run.directory, rows, finite, before)
    if not failure:
        run.rows.append(records.append_rows(run.directory / LOG, rows))
        run.track(rows)
    return failure


def _save(run: Run, state: TrainState, epoch: int, last: bool) -> None:
    """Saves a step; a failure ends the run only at its last step, as a full disk may have room again by the next.

    A failure ends a run over several hosts at once, as it may be that of one host.
    """
    kept = state if run.config.checkpoint.replay else state.without_replay
    try:
        checkpoint.save(run.directory / checkpoint.FOLDER, epoch, kept, run.about, "".join(run.rows))
        hosts.agree(lambda: note_first_step(run.directory, epoch))
    except RunError as error:
        if last or hosts.count() > 1:
            raise RunError(f"{error}; the same command continues from the previous checkpoint") from error
        say(f"warning: {error}; training continues")


def _finished(config: Config, epoch: int, seconds: float) -> bool:
    return epoch >= config.epochs or (config.minutes is not None and seconds >= 60 * config.minutes)
