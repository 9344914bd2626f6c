"""The host loop of training: clock, terminal and disk around an epoch's two compiled programs."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ear_jax.agents.networks import Params
from ear_jax.config import Config, flat, from_dict
from ear_jax.errors import RunError
from ear_jax.learning.episodes import Episodes
from ear_jax.learning.sac import CRITICS
from ear_jax.process.stopping import Stopped, StopRequest
from ear_jax.process.terminal import TrainingBar, phase, say
from ear_jax.runs import checkpoint, records, training
from ear_jax.runs.checkpoint import Step
from ear_jax.runs.directory import check_place, check_settings, check_tasks
from ear_jax.runs.estimate import check_memory
from ear_jax.runs.failure import check_finite
from ear_jax.runs.lock import lock_directory
from ear_jax.runs.seeds import over_seeds, seed_range, seed_sharding
from ear_jax.runs.training import Program, TrainState


@dataclass(frozen=True)
class Compiled:
    """A program compiled for all seeds at once; every argument and result has a leading axis [seeds].

    An epoch is two programs. On the native engine `collect` calls the host, so JAX cannot cache it and it is compiled
    at every start; `learn`, the larger one, comes from JAX's cache.
    """

    init: Callable[[jax.Array], TrainState]
    collect: Callable[[TrainState], tuple[TrainState, training.Metrics]]  # donates its argument, as `learn` does
    learn: Callable[[TrainState], tuple[TrainState, training.Metrics]]
    evaluate: Callable[[Params, jax.Array], Episodes]
    state: TrainState  # shapes only


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
    began = time.perf_counter()
    check_place(directory)
    program = training.make_program(config)
    if (directory / "config.json").exists():
        _check_same(directory, records.read_run(directory), program)
    step, epoch, spent = _progress(directory, program, say)
    if step and _finished(config, epoch, spent):
        say(f"{directory} is finished: {epoch} epochs, {spent / 60:.1f} minutes (raise --epochs or --minutes for more)")
        return
    keys = training.seed_keys(config)
    check_memory(program)
    with lock_directory(directory, say), StopRequest(say) as request:
        step, epoch, spent = _progress(directory, program, lambda _: None)  # another process may have trained meanwhile
        about = _about(program)
        _write_settings(directory / "config.json", about)
        records.keep_rows(directory / "metrics.jsonl", epoch)
        say(header(program, directory))
        with phase("compiling"):
            compiled = compile_program(program, keys)
        state = _restore(program, compiled, keys, step) if step else _begin(program, compiled, keys)
        _train_blocks(program, compiled, state, directory, about, lambda: spent + time.perf_counter() - began, request)


def _write_settings(path: Path, about: dict[str, Any]) -> None:
    """Writes config.json; for a continued run it updates only the settings, such as a higher number of epochs."""
    before = records.read_run(path.parent) if path.exists() else {}
    if flat(from_dict(before.get("config", {"family": ""}))) != flat(from_dict(about["config"])):
        records.write_json(path, {**about, **before, "config": about["config"]})


def _progress(directory: Path, program: Program, warn: Callable[[str], None]) -> tuple[Step | None, int, float]:
    """Returns a run's newest good step, its epoch and the seconds trained until then."""
    step = checkpoint.newest(directory / "checkpoints", warn)
    if step:
        _check_same(step.path, step.about, program)
    epoch = step.epoch if step else 0
    rows = records.read_rows(directory / "metrics.jsonl")
    return step, epoch, max((row["seconds"] for row in rows if row["epoch"] <= epoch), default=0.0)


def compile_program(program: Program, keys: jax.Array) -> Compiled:
    """Compiles a run's programs for the seeds' keys [seeds]; one compiles while the next is traced.

    Evaluation is compiled when it is first called, after a block.
    """
    seeds = len(keys)

    def evaluate(policy: Params, key: jax.Array) -> Episodes:
        return training.evaluate(program, policy, key, program.config.log.episodes)

    init = over_seeds(partial(training.init, program), seeds, (0,))
    collect = over_seeds(partial(training.collect, program), seeds, (0,), donate_argnums=0)
    learn = over_seeds(partial(training.learn, program), seeds, (0,), program.config.network.matmul, donate_argnums=0)
    play = over_seeds(evaluate, seeds, (0, 0))
    state = jax.eval_shape(init, keys)
    with ThreadPoolExecutor() as pool:
        lowered = (jitted.lower(argument) for jitted, argument in ((collect, state), (learn, state), (init, keys)))
        jobs = [pool.submit(traced.compile) for traced in lowered]
        collect, learn, init = (job.result() for job in jobs)
    return Compiled(init, collect, learn, play, state)


def fill_replay(compiled: Compiled, state: TrainState, epochs: int) -> TrainState:
    """Fills the replay by epochs of collection with the current policy, without updates."""
    for _ in range(epochs):
        state, _ = compiled.collect(state)
    return jax.block_until_ready(state)


def train_epochs(compiled: Compiled, state: TrainState, epochs: int) -> tuple[TrainState, list[training.Metrics]]:
    """Trains for some epochs and returns the metrics of each, without waiting for the device."""
    metrics = []
    for _ in range(epochs):
        state, collected = compiled.collect(state)
        state, learnt = compiled.learn(state)
        metrics.append({**collected, **learnt})
    return state, metrics


def _begin(program: Program, compiled: Compiled, keys: jax.Array) -> TrainState:
    with phase("collecting with the untrained policy"):
        return fill_replay(compiled, compiled.init(keys), program.config.collect.pretrain_epochs)


def _restore(program: Program, compiled: Compiled, keys: jax.Array, step: Step) -> TrainState:
    """Restores a step's state; a replay that was not saved is refilled with the current policy."""
    like = compiled.state
    differences = _differences(step.about, program)
    if differences:
        say(f"warning: {'; '.join(differences)}: results may differ in the last bit")
    with phase(f"restoring epoch {step.epoch}"):
        if step.about["replay"]:
            return jax.device_put(checkpoint.restore(step, like), seed_sharding(len(keys)))
        state = checkpoint.restore(step, like.without_replay)
    epochs = program.config.collect.pretrain_epochs
    say(
        f"warning: epoch {step.epoch} was saved without its replay; {epochs} epochs of collection "
        f"({program.env_steps(epochs):,} env steps per seed) refill it, so results will differ from an unbroken run"
    )
    state = dataclasses.replace(state, replay=jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), like.replay))
    with phase("collecting with the current policy"):
        return fill_replay(compiled, jax.device_put(state, seed_sharding(len(keys))), epochs)


def _train_blocks(
    program: Program,
    compiled: Compiled,
    state: TrainState,
    directory: Path,
    about: dict[str, Any],
    clock: Callable[[], float],
    request: StopRequest,
) -> None:
    """Trains block by block until the run is finished or stopped; each block is evaluated, recorded and maybe saved."""
    config, keys = program.config, training.seed_keys(program.config)
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
            finite = sum(epoch_metrics.pop("finite_updates") for epoch_metrics in metrics)  # [seeds, tasks]
            rows = _rows(program, state, clock(), metrics, episodes)
            check_finite(directory, rows, finite, (epoch - count) * config.sac.updates)
            records.append_rows(directory / "metrics.jsonl", rows)
            last = _finished(config, epoch, clock()) or request.signal is not None
            if last or blocks % config.checkpoint.blocks == 0:
                _save(directory, state, about, last)
            steps, updates = count * program.env_steps_per_epoch, count * config.sac.updates
            mean_return = float(np.mean(episodes.returns))
            steps_rate, updates_rate = (config.seeds * number / block_seconds for number in (steps, updates))
            bar.update(epoch, mean_return, steps_rate, updates_rate)
    if request.signal is not None:
        say(f"stopped at epoch {epoch}; the same command continues")
        raise Stopped(request.signal)


def _save(directory: Path, state: TrainState, about: dict[str, Any], last: bool) -> None:
    """Saves a step; a failure ends the run only at its last step, as a full disk may have room again by the next."""
    kept = state if about["replay"] else state.without_replay
    try:
        checkpoint.save(directory / "checkpoints", int(state.epoch[0]), kept, about)
    except RunError as error:
        if last:
            raise RunError(f"{error}; the same command continues from the previous checkpoint") from error
        say(f"warning: {error}; training continues")


def _finished(config: Config, epoch: int, seconds: float) -> bool:
    return epoch >= config.epochs or (config.minutes is not None and seconds >= 60 * config.minutes)


def _rows(
    program: Program, state: TrainState, seconds: float, metrics: list[training.Metrics], episodes: Episodes
) -> list[dict[str, Any]]:
    """Builds one row per seed: means of metrics over the block's epochs, and evaluated returns by task."""
    returns = episodes.returns.mean(axis=-1)  # [seeds, tasks]
    means = jax.tree.map(lambda *epochs: np.mean(epochs, axis=0), *metrics)  # each [seeds]
    epoch = int(state.epoch[0])
    return [
        {
            "seed": program.config.seed + index,
            "epoch": epoch,
            "env_steps": program.env_steps(int(state.collected[0])),
            "updates": epoch * program.config.sac.updates,
            "seconds": round(seconds, 3),
            "mean_return": float(returns[index].mean()),
            "returns": dict(zip(program.tasks.names, returns[index].tolist(), strict=True)),
            **{name: float(value[index]) for name, value in means.items()},
        }
        for index in range(program.config.seeds)
    ]


def _about(program: Program) -> dict[str, Any]:
    """Returns the document that describes a run in its `config.json` and checkpoints."""
    return {
        "config": dataclasses.asdict(program.config),
        "tasks": program.tasks.document,
        "parameters": program.agent.parameter_counts,
        "fingerprint": program.tasks.fingerprint,
        "engine": program.family.engine.name,
        "replay": program.config.checkpoint.replay,
        **records.provenance(),
    }


def _differences(about: dict[str, Any], program: Program) -> list[str]:
    """Lists differences from the engine and versions that wrote a step, which may change results in the last bit."""
    now = {"engine": program.family.engine.name, **records.versions()}
    before = {"engine": about["engine"], **about["versions"]}
    return [f"{name} was {before.get(name)}, is {value}" for name, value in now.items() if before.get(name) != value]


def _check_same(holder: Path, document: dict[str, Any], program: Program) -> None:
    check_settings(holder, document, program.config)
    check_tasks(holder, document, program.tasks)


def header(program: Program, directory: Path) -> str:
    """Returns the line that a run prints first."""
    config = program.config
    counts = program.agent.parameter_counts
    critics = f", {CRITICS} critics of {counts['critic']:,}" if counts["critic"] else ""
    return (
        f"{config.family} · {config.agent} · preset {config.preset} · {len(program.tasks)} tasks · "
        f"{seed_range(config)} · policy of {counts['policy']:,} parameters{critics} · "
        f"engine {program.family.engine.name} on {jax.default_backend()} · {directory}"
    )
