"""The host loop of training: clock, terminal and disk around one compiled chunk."""

from __future__ import annotations

import dataclasses
import math
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ear_jax import checkpoint, records, runtime, train
from ear_jax.config import Config, from_dict, run_name
from ear_jax.errors import RunError, UsageError
from ear_jax.evaluate import Episodes, play_training_tasks
from ear_jax.learner import CRITICS
from ear_jax.networks import Params
from ear_jax.stopping import Stopped, StopRequest
from ear_jax.terminal import TrainingBar, phase, say
from ear_jax.train import Program, TrainState

# Settings that may differ when a run is continued: none of them changes what an epoch computes.
MAY_CHANGE = ("epochs", "minutes", "engine", "log.checkpoint_blocks")


@dataclass(frozen=True)
class Compiled:
    """A program compiled for all seeds at once; each argument and result has a leading axis [seeds]."""

    begin: Callable[[jax.Array], TrainState]
    chunk: Callable[[TrainState, jax.Array], tuple[TrainState, train.Metrics]]
    evaluate: Callable[[Params, jax.Array], Episodes]


def default_directory(config: Config) -> Path:
    return Path("runs") / run_name(config)


def train_run(config: Config, directory: Path) -> None:
    """Trains a run to its end, or continues it.

    Args:
      config: what to train.
      directory: where; the same command on an unfinished run goes on from its newest checkpoint, and on a finished one
        does nothing.

    Raises:
      UsageError: the configuration makes no sense, or is not the run's.
      RunError: it cannot be done here.
      Stopped: it was asked to stop, and has saved.
    """
    began = time.perf_counter()
    _check_directory(directory, config)
    steps = checkpoint.steps(directory / "checkpoints")
    rows = records.keep_rows(directory / "metrics.jsonl", steps[-1] if steps else 0)
    spent = rows[-1]["seconds"] if rows else 0.0
    if steps and _finished(config, steps[-1], spent):
        say(f"{directory} is finished: {steps[-1]} epochs, {spent / 60:.1f} minutes (--epochs or --minutes for more)")
        return
    program = train.make_program(config)
    keys = train.seed_keys(config)
    _check_memory(program, keys)
    if not steps:
        _make(directory)
        document = {
            "config": dataclasses.asdict(config),
            "tasks": _tasks_document(program),
            "parameters": program.agent.parameter_counts,
            **records.provenance(),
        }
        records.write_json(directory / "config.json", document)
    say(_header(program, directory))
    with phase("compiling"):
        compiled = compile_program(program, keys)
    if steps:
        with phase(f"restoring epoch {steps[-1]}"):
            state = checkpoint.restore(directory / "checkpoints", steps[-1], jax.eval_shape(compiled.begin, keys))
    else:
        with phase("collecting with the untrained policy"):
            state = jax.block_until_ready(compiled.begin(keys))
    with StopRequest(say) as request:
        _train_blocks(program, compiled, state, directory, lambda: spent + time.perf_counter() - began, request)


def compile_program(program: Program, keys: jax.Array) -> Compiled:
    """Compiles everything a run calls; `keys` [seeds] only for its shape."""
    compile_options = runtime.compiler_options()

    def evaluate(policy: Params, key: jax.Array) -> Episodes:
        return play_training_tasks(program, policy, key, program.config.log.episodes)

    begin = jax.jit(jax.vmap(partial(train.begin, program)), compiler_options=compile_options)
    chunk = jax.jit(
        jax.vmap(partial(train.train_chunk, program), in_axes=(0, None)),
        donate_argnums=0,
        compiler_options=compile_options,
    )
    state = jax.eval_shape(begin, keys)
    return Compiled(
        begin=begin,
        chunk=chunk.lower(state, jax.ShapeDtypeStruct((), jnp.int32)).compile(),
        evaluate=jax.jit(jax.vmap(evaluate), compiler_options=compile_options),
    )


def _train_blocks(
    program: Program,
    compiled: Compiled,
    state: TrainState,
    directory: Path,
    clock: Callable[[], float],
    request: StopRequest,
) -> None:
    """Blocks of epochs until the run is finished or asked to stop: train, evaluate, write, maybe save."""
    config, keys = program.config, train.seed_keys(program.config)
    epoch, blocks = int(state.epoch[0]), 0
    with TrainingBar(epoch, config.epochs) as bar:
        while not _finished(config, epoch, clock()) and request.signal is None:
            block_began = time.perf_counter()
            count = min(config.log.epochs, config.epochs - epoch)
            state, metrics = compiled.chunk(state, jnp.int32(count))
            epoch, blocks = epoch + count, blocks + 1
            episodes = compiled.evaluate(state.learner.policy, train.evaluation_keys(keys, epoch))
            metrics, episodes = jax.device_get((metrics, episodes))  # waits for the device, once a block
            took = time.perf_counter() - block_began
            rows = _rows(program, epoch, clock(), metrics, episodes)
            _refuse_non_finite(rows)
            records.append_rows(directory / "metrics.jsonl", rows)
            last = _finished(config, epoch, clock()) or request.signal is not None
            if last or blocks % config.log.checkpoint_blocks == 0:
                checkpoint.save(directory / "checkpoints", epoch, state)
            steps, updates = count * program.env_steps_per_epoch, count * config.sac.updates
            mean_return = float(np.mean(episodes.returns))
            bar.update(epoch, mean_return, config.seeds * steps / took, config.seeds * updates / took)
    if request.signal is not None:
        say(f"stopped at epoch {epoch}; the same command continues")
        raise Stopped(request.signal)


def _finished(config: Config, epoch: int, seconds: float) -> bool:
    return epoch >= config.epochs or (config.minutes is not None and seconds >= 60 * config.minutes)


def _rows(
    program: Program, epoch: int, seconds: float, metrics: train.Metrics, episodes: Episodes
) -> list[dict[str, Any]]:
    """A row a seed; `returns` are of whole evaluation episodes without exploration."""
    returns = episodes.returns.mean(axis=-1)  # [seeds, tasks]
    return [
        {
            "seed": program.config.seed + index,
            "epoch": epoch,
            "env_steps": program.env_steps(epoch),
            "updates": epoch * program.config.sac.updates,
            "seconds": round(seconds, 3),
            "mean_return": float(returns[index].mean()),
            "returns": dict(zip(program.tasks.names, returns[index].tolist(), strict=True)),
            **{name: float(value[index]) for name, value in metrics.items()},
        }
        for index in range(program.config.seeds)
    ]


def _refuse_non_finite(rows: list[dict[str, Any]]) -> None:
    for row in rows:
        for name, value in row.items():
            if isinstance(value, float) and not math.isfinite(value):
                raise RunError(f"{name} of seed {row['seed']} is {value} at epoch {row['epoch']}")


def _check_directory(directory: Path, config: Config) -> None:
    """Refuses a directory that cannot hold this run, before anything slow and before anything is written."""
    standing = next(path for path in (directory, *directory.absolute().parents) if path.exists())
    if not standing.is_dir():
        raise UsageError(f"--out {directory} needs a directory, and {standing} is a file")
    if not os.access(standing, os.W_OK | os.X_OK):
        raise RunError(f"cannot write in {standing}")
    if (directory / "config.json").exists():
        _refuse_changes(directory, from_dict(records.read_run(directory)["config"]), config)
    elif directory.exists() and any(directory.iterdir()):
        raise UsageError(f"--out {directory} is neither empty nor a run directory; name another")


def _make(directory: Path) -> None:
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RunError(f"cannot make {directory}: {error.strerror}") from None


def _refuse_changes(directory: Path, before: Config, now: Config) -> None:
    old, new = (dict(_flat(dataclasses.asdict(config))) for config in (before, now))
    changes = [f"{name} was {old[name]}, is {new[name]}" for name in old if old[name] != new[name]]
    changes = [change for change in changes if not change.startswith(tuple(f"{name} was" for name in MAY_CHANGE))]
    if changes:
        raise UsageError(f"{directory} holds a run with other settings: {'; '.join(changes)}; use another --out")


def _flat(tree: dict[str, Any], where: str = "") -> list[tuple[str, Any]]:
    pairs: list[tuple[str, Any]] = []
    for name, value in tree.items():
        pairs += _flat(value, f"{where}{name}.") if isinstance(value, dict) else [(where + name, value)]
    return pairs


def _check_memory(program: Program, keys: jax.Array) -> None:
    state = jax.eval_shape(jax.vmap(partial(train.init, program)), keys)
    runtime.check_memory(runtime.tree_bytes(state), runtime.tree_bytes(state.replay))


def _tasks_document(program: Program) -> list[dict[str, Any]]:
    return [dataclasses.asdict(task) for task in program.tasks.tasks]


def _header(program: Program, directory: Path) -> str:
    config = program.config
    counts = program.agent.parameter_counts
    seeds = f"seed {config.seed}" if config.seeds == 1 else f"seeds {config.seed}–{config.seed + config.seeds - 1}"
    return (
        f"{config.family} · {config.agent} · preset {config.preset} · {len(program.tasks)} tasks · {seeds} · "
        f"policy of {counts['policy']:,} parameters, {CRITICS} critics of {counts['critic']:,} · "
        f"engine {program.family.engine.name} on {jax.default_backend()} · {directory}"
    )
