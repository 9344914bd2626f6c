"""Estimates of a run before it starts: memory from shapes, time from a few steps and updates made here."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax

from ear_jax.config import Config
from ear_jax.errors import RunError
from ear_jax.methods import find_method
from ear_jax.process import hosts, runtime
from ear_jax.process.memory import Room, available
from ear_jax.process.target import on_accelerator
from ear_jax.process.terminal import phase
from ear_jax.runs import training
from ear_jax.runs.on_host import compiler_of
from ear_jax.runs.rollouts import epoch_bytes
from ear_jax.runs.seeds import devices_for
from ear_jax.runs.training import Program

TIMED = 5  # steps and updates
REPEATS = 3  # the fastest counts
# What a run takes on the CPU beside its state, as measured.
COMPILING, COMPILING_RESERVES = 950_000_000, 1_300_000_000  # bytes used, and bytes of address space
SAVING = 1.0  # times the state


@dataclass(frozen=True)
class Memory:
    """Bytes for all seeds together."""

    replay: int
    learner: int  # networks, targets and optimisers
    state: int  # both, the environments and counters
    epoch: int  # roll-outs and random numbers of an epoch
    compiling: int
    saving: int
    room: Room | None  # under the limit that is nearest; None if none is known

    @property
    def total(self) -> int:
        """All of it: what compiling took is not given back before the first save."""
        return self.state + self.epoch + self.compiling + self.saving


@dataclass(frozen=True)
class Times:
    """Seconds for all seeds together."""

    compiling: float
    epoch: float
    evaluation: float  # after each block


def memory(program: Program) -> Memory:
    """Returns the memory that a run will take on this host beside what this process has, without allocating it."""
    rooms = available(devices_for(program.config.seeds))
    program = replace(program, config=replace(program.config, seeds=program.config.seeds // hosts.count()))
    state = jax.eval_shape(lambda: jax.vmap(partial(training.init, program))(training.seed_keys(program.config)))
    replay, learner, whole = (runtime.tree_bytes(part) for part in (state.replay, state.learner, state))
    sizes = (replay, learner, whole, epoch_bytes(program))
    needed = [Memory(*sizes, *_beside(whole, room), room) for room in rooms]
    return min(needed, key=_spare, default=Memory(*sizes, *_beside(whole, None), None))


def _beside(state: int, room: Room | None) -> tuple[int, int]:
    """Returns the bytes that compiling and saving a state take under a limit."""
    if room and room.of_device:
        return 0, 0  # both take place on the host
    return (COMPILING_RESERVES if room and room.virtual else COMPILING), int(SAVING * state)


def _spare(needed: Memory) -> int:
    return (needed.room.bytes if needed.room else 0) - needed.total


def check_memory(program: Program) -> None:
    """Raises RunError, with the sizes and the limit, if a run does not fit in memory."""
    needed = memory(program)
    if needed.room is not None and _spare(needed) < 0:
        of_epoch = "--collect.envs, --collect.steps, --log.episodes, --sac.updates, --sac.batch-size"
        lower = of_epoch if needed.epoch > needed.replay else "--replay.capacity"
        raise RunError(
            f"this run needs {gigabytes(needed.total)} of memory ({describe(needed)}), but only "
            f"{gigabytes(max(0, needed.room.bytes))} is free under {needed.room.limit}; "
            f"lower {lower} or --seeds, or raise the limit"
        )


def describe(needed: Memory) -> str:
    """Returns the parts of a run's memory in words."""
    return (
        f"replay {gigabytes(needed.replay)}, networks and optimisers {gigabytes(needed.learner)}, "
        f"an epoch {gigabytes(needed.epoch)}, "
        f"compiling {gigabytes(needed.compiling)}, saving {gigabytes(needed.saving)}"
    )


def gigabytes(count: int) -> str:
    """Formats bytes as GB."""
    return f"{count / 1e9:.2f} GB"


def times(config: Config) -> Times:
    """Times a program with only a few steps and updates per epoch, and extrapolates to an epoch of the run.

    Environments step where those of the run do: on the device, or on the host beside it.

    Args:
      config: the run's; its whole replay is allocated.
    """
    collect, sac = config.collect, config.sac
    steps, updates = min(TIMED, collect.steps), min(TIMED, sac.updates)
    if find_method(config.agent).learner.on_policy:  # its update needs all steps of the epoch
        steps, updates = collect.steps, sac.updates
    short = replace(config, collect=replace(collect, steps=steps), sac=replace(sac, updates=updates))
    program, keys = training.make_program(short), training.seed_keys(short)
    began = time.perf_counter()
    with phase("compiling"):
        compiled = compiler_of(program)(program, keys)
        state, _ = compiled.learn(compiled.collect(compiled.init(keys))[0])
        jax.block_until_ready(compiled.evaluate(state.learner.policy, keys))
    compiling = time.perf_counter() - began
    with phase(f"timing {steps} steps and {updates} updates"):
        collect_seconds, state = _fastest(lambda state: compiled.collect(state)[0], state)
        learn_seconds, state = _fastest(lambda state: compiled.learn(state)[0], state)
        evaluation, _ = _fastest(lambda state: compiled.evaluate(state.learner.policy, keys), state, repeats=1)
    halves = (collect_seconds / steps * collect.steps, learn_seconds / updates * sac.updates)
    overlap = compiled.both is not None and on_accelerator()  # on a CPU both have the same cores
    return Times(compiling, max(halves) if overlap else sum(halves), evaluation)


def _fastest(run: Callable[[Any], Any], state: Any, repeats: int = REPEATS) -> tuple[float, Any]:
    """Returns the seconds of the fastest of several runs, each given the last one's result, and the final result."""
    seconds = []
    for _ in range(repeats):
        began = time.perf_counter()
        state = jax.block_until_ready(run(state))
        seconds.append(time.perf_counter() - began)
    return min(seconds), state
