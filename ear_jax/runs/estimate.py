"""Estimates of a run before it starts: memory from shapes, time from a few steps and updates made here."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax

from ear_jax.agents.networks import Params
from ear_jax.config import Config
from ear_jax.errors import RunError
from ear_jax.learning.episodes import Episodes
from ear_jax.methods import find_method
from ear_jax.process import runtime
from ear_jax.process.terminal import phase
from ear_jax.runs import training
from ear_jax.runs.seeds import devices_for
from ear_jax.runs.training import Program

TIMED = 5  # steps and updates
REPEATS = 3  # the fastest counts


@dataclass(frozen=True)
class Memory:
    """Bytes for all seeds together."""

    replay: int
    learner: int  # networks, targets and optimisers
    total: int
    available: int | None  # None if unknown


@dataclass(frozen=True)
class Times:
    """Seconds for all seeds together."""

    compiling: float
    epoch: float
    evaluation: float  # after each block


def memory(program: Program) -> Memory:
    """Returns the memory of a run's state, without allocating it."""
    state = jax.eval_shape(jax.vmap(partial(training.init, program)), training.seed_keys(program.config))
    replay, learner, total = (runtime.tree_bytes(part) for part in (state.replay, state.learner, state))
    return Memory(replay, learner, total, runtime.available_bytes(devices_for(program.config.seeds)))


def check_memory(program: Program) -> None:
    """Raises RunError, with the sizes, if a run's state does not fit in memory."""
    needed = memory(program)
    if needed.available is not None and needed.total > needed.available:
        raise RunError(
            f"this run needs {gigabytes(needed.total)} of memory, {gigabytes(needed.replay)} of it for replay, but "
            f"only {gigabytes(needed.available)} is free; lower --replay.capacity or --seeds"
        )


def gigabytes(count: int) -> str:
    """Formats bytes as GB."""
    return f"{count / 1e9:.2f} GB"


def times(config: Config) -> Times:
    """Times a program with only a few steps and updates per epoch, and extrapolates to an epoch of the run.

    Args:
      config: the run's; its whole replay is allocated.
    """
    collect, sac = config.collect, config.sac
    steps, updates = min(TIMED, collect.steps), min(TIMED, sac.updates)
    if find_method(config.agent).learner.on_policy:  # its update needs all steps of the epoch
        steps, updates = collect.steps, sac.updates
    short = replace(config, collect=replace(collect, steps=steps), sac=replace(sac, updates=updates))
    program, keys = training.make_program(short), training.seed_keys(short)
    compiler_options = runtime.compiler_options(config.network.matmul)

    def compiled(function: Callable[..., Any], **options: Any) -> Callable[..., Any]:
        return jax.jit(jax.vmap(function), compiler_options=compiler_options, **options)

    def evaluate(policy: Params, key: jax.Array) -> Episodes:
        return training.evaluate(program, policy, key, config.log.episodes)

    collecting = compiled(lambda state: training.collect(program, state)[0], donate_argnums=0)
    learning = compiled(lambda state: training.learn(program, state)[0], donate_argnums=0)
    evaluating = compiled(evaluate)
    began = time.perf_counter()
    with phase("compiling"):
        state = learning(collecting(compiled(partial(training.init, program))(keys)))
        jax.block_until_ready(evaluating(state.learner.policy, keys))
    compiling = time.perf_counter() - began
    with phase(f"timing {steps} steps and {updates} updates"):
        collect_seconds, state = _fastest(collecting, state)
        learn_seconds, state = _fastest(learning, state)
        evaluation, _ = _fastest(lambda state: evaluating(state.learner.policy, keys), state, repeats=1)
    epoch = collect_seconds / steps * collect.steps + learn_seconds / updates * sac.updates
    return Times(compiling, epoch, evaluation)


def _fastest(run: Callable[[Any], Any], state: Any, repeats: int = REPEATS) -> tuple[float, Any]:
    """Returns the seconds of the fastest of several runs, each given the last one's result, and the final result."""
    seconds = []
    for _ in range(repeats):
        began = time.perf_counter()
        state = jax.block_until_ready(run(state))
        seconds.append(time.perf_counter() - began)
    return min(seconds), state
