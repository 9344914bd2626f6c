"""Collection by C MuJoCo on the host's cores, beside the device that learns.

Replay and parameters stay on the device, environments on the host. An epoch moves the policy to the host and its
transitions, some megabytes, to the device.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import numpy as np
from flax import struct

from ear_jax.agents.networks import Params
from ear_jax.envs.batched_env import EnvState, Transition
from ear_jax.errors import UsageError
from ear_jax.learning.sac import SacLearner
from ear_jax.process import hosts
from ear_jax.process.runtime import compiler_options
from ear_jax.process.target import on_accelerator, tracing_for
from ear_jax.runs import training
from ear_jax.runs.compiled import Compiled, compile_program, evaluate, given_numbers
from ear_jax.runs.seeds import over_seeds, seed_sharding
from ear_jax.runs.training import Metrics, Program, TrainState


@struct.dataclass
class Plan:
    """The part of a learner that an epoch of collection needs."""

    policy: Params
    codes: jax.Array  # [tasks, code]
    key: jax.Array


def collects_on_host(program: Program) -> bool:
    """Returns whether a run's environments step on the host while another device, or the same later, learns.

    Raises:
      UsageError: `collect.overlap` is set and nothing can overlap; an on-policy method would collect beside an
        accelerator, or several hosts would.
    """
    native, overlap = program.family.engine.name == "native", program.config.collect.overlap
    if native and hosts.count() > 1 and (overlap or on_accelerator()):
        raise UsageError("a run over several hosts collects where it learns: --engine mjx, no --collect.overlap")
    if native and program.learner.on_policy and on_accelerator():
        raise UsageError(f"--engine native cannot train agent {program.config.agent} on an accelerator; use mjx")
    if overlap and (not native or program.learner.on_policy):
        raise UsageError("--collect.overlap True needs --engine native and an agent that learns from replay")
    return native and (overlap or on_accelerator())


def compiler_of(program: Program) -> Callable[..., Compiled]:
    """Returns the function that compiles a run for where its environments step: `compile_on_host`, `compile_program`.

    Raises:
      UsageError: as `collects_on_host`.
    """
    return compile_on_host if collects_on_host(program) else compile_program


def plan(program: Program, state: TrainState) -> tuple[jax.Array, Plan]:
    """Returns one seed's later key and its plan of an epoch, with the randomness of `training.collect`."""
    key, later = jax.random.split(state.key)
    policy = state.learner.policy
    return later, Plan(policy, _learner(program).codes_to_act(policy, state.replay, key), key)


def explore(program: Program, plan: Plan, cells: EnvState) -> tuple[EnvState, Transition]:
    """Steps one seed's environments through an epoch; transitions are [steps, tasks, envs]."""
    return _learner(program).explore(plan.policy, plan.codes, cells, plan.key)


def store(program: Program, state: TrainState, transitions: Transition) -> tuple[TrainState, Metrics]:
    """Adds one seed's transitions to its replay."""
    memory, metrics = _learner(program).store(state.replay, transitions)
    return replace(state, replay=memory, collected=state.collected + 1), metrics


def _learner(program: Program) -> SacLearner:
    assert isinstance(program.learner, SacLearner), "only what learns from replay collects on the host"
    return program.learner


@dataclass(frozen=True)
class HostCollection:
    """Compiled parts of an epoch for all members; states on the device have no environments."""

    plan: Callable[[TrainState], tuple[jax.Array, Plan]]
    explore: Callable[[Plan, EnvState], tuple[EnvState, Transition]]
    store: Callable[[TrainState, Transition], tuple[TrainState, Metrics]]
    learn: Callable[[TrainState], tuple[TrainState, Metrics]]
    members: int

    def collect(self, state: TrainState) -> tuple[TrainState, Metrics]:
        """Runs an epoch of collection, as `training.collect` does on one device."""
        state, planned = self._planned(state)
        return self._stored(state, *self.explore(*planned))

    def update(self, state: TrainState) -> tuple[TrainState, Metrics]:
        """Runs an epoch of updates."""
        learnt, metrics = self.learn(_without_cells(state))
        return replace(learnt, cells=state.cells), metrics

    def overlapped(self, state: TrainState) -> tuple[TrainState, Metrics]:
        """Collects with the policy as it is while the updates of the epoch are made, and stores after them.

        A program that calls the host returns only at its end, so it has a thread of its own.
        """
        state, planned = self._planned(state)
        with ThreadPoolExecutor(1) as thread:
            exploring = thread.submit(self.explore, *planned)
            state, learnt = self.learn(state)
        state, collected = self._stored(state, *exploring.result())
        return state, {**collected, **learnt}

    def _planned(self, state: TrainState) -> tuple[TrainState, tuple[Plan, EnvState]]:
        """Returns a state without environments, and on the host the plan of an epoch with its environments.

        The plan is a copy, as updates write over the policy it is made of.
        """
        held = _without_cells(state)
        later, planned = self.plan(held)
        planned = jax.device_put(planned, host_device(), may_alias=False)
        return replace(held, key=later), (planned, *_on_host(state.cells))

    def _stored(self, state: TrainState, cells: EnvState, transitions: Transition) -> tuple[TrainState, Metrics]:
        state, metrics = self.store(state, jax.device_put(transitions, seed_sharding(self.members)))
        return replace(state, cells=cells), metrics


def _without_cells(state: TrainState) -> TrainState:
    """Returns a state without its environments, which are on another device."""
    return replace(state, cells=None)  # type: ignore[arg-type]


def host_device() -> jax.Device:
    """Returns the processor as a device of JAX, which it is beside any accelerator."""
    return jax.local_devices(backend="cpu")[0]


def compile_on_host(program: Program, keys: jax.Array, numbers: Mapping[str, np.ndarray] | None = None) -> Compiled:
    """Compiles a run as `compile_program` does, with environments on the host."""
    members, given = len(keys), dict(numbers or {})

    def of_members(function: Callable[..., Any], matmul: str = "float32", **options: Any) -> Any:
        return over_seeds(given_numbers(program, function), members, matmul, **options)

    start = of_members(training.init)
    state = jax.eval_shape(start, given, keys)
    held = _without_cells(state)
    planning, exploring, playing = of_members(plan), _OnHost(program, explore), _OnHost(program, evaluate)
    planned = jax.eval_shape(planning, given, held)[1]
    transitions = exploring.shapes(given, planned, state.cells)[1]
    storing = of_members(store, donate_argnums=1)
    learning = of_members(training.learn, program.config.network.matmul, donate_argnums=1)
    with ThreadPoolExecutor() as pool:
        roll = pool.submit(exploring.compile, given, planned, state.cells)
        on_device = ((learning, (held,)), (planning, (held,)), (storing, (held, transitions)), (start, (keys,)))
        jobs = [pool.submit(jitted.lower(given, *arguments).compile) for jitted, arguments in on_device]
        learn, planner, store_in, init = (partial(job.result(), given) for job in jobs)
        parts = HostCollection(planner, partial(roll.result(), *_on_host(given)), store_in, learn, members)
    both = parts.overlapped if program.config.collect.overlap else None
    return Compiled(init, parts.collect, parts.update, partial(playing, given), state, both)


class _OnHost:
    """A function of one member, traced and compiled for the processor and all members."""

    def __init__(self, program: Program, function: Callable[..., Any]):
        with tracing_for("cpu"):
            options = compiler_options()
        self._jitted = jax.jit(jax.vmap(given_numbers(program, function)), compiler_options=options)

    def shapes(self, *arguments: Any) -> Any:
        with tracing_for("cpu"):
            return jax.eval_shape(self._jitted, *arguments)

    def compile(self, *arguments: Any) -> Callable[..., Any]:
        """Compiles for arguments of these shapes."""
        host = jax.sharding.SingleDeviceSharding(host_device())
        there = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype, sharding=host), arguments)
        with tracing_for("cpu"):
            return self._jitted.lower(*there).compile()

    def __call__(self, *arguments: Any) -> Any:
        with tracing_for("cpu"):
            return self._jitted(*_on_host(*arguments))


def _on_host(*arguments: Any) -> Any:
    return jax.device_put(arguments, host_device())
