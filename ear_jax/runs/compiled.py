"""The training program compiled for all runs and seeds that train side by side, and epochs of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import numpy as np

from ear_jax.agents.networks import Params
from ear_jax.learning.episodes import Episodes
from ear_jax.process.target import on_accelerator
from ear_jax.runs import training
from ear_jax.runs.seeds import over_seeds, spread
from ear_jax.runs.training import Program, TrainState


@dataclass(frozen=True)
class Compiled:
    """A program compiled for all members at once; every argument and result has a leading axis [members].

    The members are the seeds of all runs that train side by side.

    An epoch is two programs. On the native engine `collect` calls the host, so JAX cannot cache it and it is compiled
    at every start; `learn`, the larger one, comes from JAX's cache.
    """

    init: Callable[[jax.Array], TrainState]
    collect: Callable[[TrainState], tuple[TrainState, training.Metrics]]  # donates its argument, as `learn` does
    learn: Callable[[TrainState], tuple[TrainState, training.Metrics]]
    evaluate: Callable[[Params, jax.Array], Episodes]
    state: TrainState  # shapes only
    both: Callable[[TrainState], tuple[TrainState, training.Metrics]] | None = None  # an epoch whose halves overlap


def compile_program(program: Program, keys: jax.Array, numbers: Mapping[str, np.ndarray] | None = None) -> Compiled:
    """Compiles a run's programs for all members; one compiles while the next is traced.

    Evaluation is compiled when it is first called, after a block.

    Args:
      program: the settings that all members share.
      keys: each member's initial key, [members].
      numbers: settings in which members differ, each [members]; they are arguments of what is compiled.
    """
    members, spread_numbers = len(keys), {name: spread(values) for name, values in (numbers or {}).items()}

    def of_members(function: Callable[..., Any], matmul: str = "float32", **options: Any) -> Any:
        return over_seeds(given_numbers(program, function), members, matmul, **options)

    start, play = of_members(training.init), over_seeds(partial(evaluate, program), members)
    state, in_turn = jax.eval_shape(start, spread_numbers, keys), not on_accelerator()
    jitted = (
        (of_members(training.collect, donate_argnums=1), state),
        (of_members(training.learn, program.config.network.matmul, in_turn=in_turn, donate_argnums=1), state),
        (start, keys),
    )
    with ThreadPoolExecutor() as pool:
        jobs = [pool.submit(function.lower(spread_numbers, argument).compile) for function, argument in jitted]
        collecting, learning, starting = (partial(job.result(), spread_numbers) for job in jobs)
    return Compiled(starting, collecting, learning, play, state)


def given_numbers(program: Program, function: Callable[..., Any]) -> Callable[..., Any]:
    """Returns a function of a program and arguments as one of a member's numbers and the same arguments."""
    return lambda numbers, *arguments: function(training.with_numbers(program, numbers), *arguments)


def evaluate(program: Program, policy: Params, key: jax.Array) -> Episodes:
    """Plays as many episodes of each task as the log has."""
    return training.evaluate(program, policy, key, program.config.log.episodes)


def fill_replay(compiled: Compiled, state: TrainState, epochs: int) -> TrainState:
    """Fills the replay by epochs of collection with the current policy, without updates."""
    for _ in range(epochs):
        state, _ = compiled.collect(state)
    return jax.block_until_ready(state)


def train_epochs(compiled: Compiled, state: TrainState, epochs: int) -> tuple[TrainState, list[training.Metrics]]:
    """Trains for some epochs and returns the metrics of each, without waiting for the device."""
    metrics = []
    for _ in range(epochs):
        if compiled.both:
            state, row = compiled.both(state)
            metrics.append(row)
            continue
        state, collected = compiled.collect(state)
        state, learnt = compiled.learn(state)
        metrics.append({**collected, **learnt})
    return state, metrics
