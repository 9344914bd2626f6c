"""What a run will take, told before it starts: memory by its shapes, time by a few steps and updates made here."""

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

FEW = 5  # steps and updates that are timed
REPEATS = 3


@dataclass(frozen=True)
class Memory:
    """Bytes of all seeds together."""

    replay: int
    learner: int  # networks, targets and optimisers
    total: int
    available: int | None  # None where it cannot be told


@dataclass(frozen=True)
class Times:
    """Seconds of all seeds together."""

    compiling: float
    epoch: float
    evaluation: float  # after each block


def memory(program: Program) -> Memory:
    """What a run's state takes; nothing is allocated."""
    state = jax.eval_shape(jax.vmap(partial(training.init, program)), training.seed_keys(program.config))
    replay, learner, total = (runtime.tree_bytes(part) for part in (state.replay, state.learner, state))
    return Memory(replay, learner, total, runtime.available_bytes(devices_for(program.config.seeds)))


def check_memory(program: Program) -> None:
    """Refuses a run that will not fit; raises RunError with the sizes."""
    needed = memory(program)
    if needed.available is not None and needed.total > needed.available:
        raise RunError(
            f"this run needs {gigabytes(needed.total)} of memory, {gigabytes(needed.replay)} of it for replay, and "
            f"{gigabytes(needed.available)} are free; lower --replay.capacity or --seeds"
        )


def gigabytes(count: int) -> str:
    return f"{count / 1e9:.2f} GB"


def times(config: Config) -> Times:
    """Times what an epoch is made of, steps and updates, by a program that does only a few of each.

    Args:
      config: of the run; its whole replay is allocated.
    """
    collect, sac = config.collect, config.sac
    steps, updates = min(FEW, collect.steps), min(FEW, sac.updates)
    if find_method(config.agent).learner.on_policy:  # an update sees all steps of its epoch
        steps, updates = collect.steps, sac.updates
    few = replace(config, collect=replace(collect, steps=steps), sac=replace(sac, updates=updates))
    program, keys = training.make_program(few), training.seed_keys(few)
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
        collected, state = _fastest(collecting, state)
        learnt, state = _fastest(learning, state)
        evaluated, _ = _fastest(lambda state: evaluating(state.learner.policy, keys), state, repeats=1)
    return Times(compiling, collected / steps * collect.steps + learnt / updates * sac.updates, evaluated)


def _fastest(run: Callable[[Any], Any], state: Any, repeats: int = REPEATS) -> tuple[float, Any]:
    """Seconds of the fastest of some runs, each on what the one before returned, and what the last returned."""
    seconds = []
    for _ in range(repeats):
        began = time.perf_counter()
        state = jax.block_until_ready(run(state))
        seconds.append(time.perf_counter() - began)
    return min(seconds), state
