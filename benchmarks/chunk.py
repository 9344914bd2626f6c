"""Wall time of an epoch of training: its parts, each compiled alone, and the whole epoch as in a run."""

from __future__ import annotations

import argparse
import dataclasses
import sys
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from benchmarks import common
from benchmarks.update import filled
from ear_jax.cli.exits import exit_code
from ear_jax.config import Config
from ear_jax.envs.batched_env import BatchedEnv, Transition
from ear_jax.learning import replay
from ear_jax.learning.replay import Replay
from ear_jax.learning.rollout import act_with, rollout
from ear_jax.learning.sac_state import SacState
from ear_jax.presets import preset_config
from ear_jax.process import runtime
from ear_jax.runs import training
from ear_jax.runs.compiled import compile_program, train_epochs
from ear_jax.runs.training import Program, TrainState

PARTS = ("collect", "add", "update")
Step = Callable[[Any], Any]


def collect(program: Program, state: TrainState) -> Transition:
    """Returns the transitions of an epoch's roll-out."""
    settings, family, policy = program.config.collect, program.family, state.learner.policy
    noise = jax.random.normal(state.key, (settings.steps, len(program.tasks), settings.envs, family.action_size))
    act = act_with(program.agent, policy, program.agent.codes(policy))
    return rollout(BatchedEnv(family), act, state.cells, noise, lambda transition: transition)[1]


def update(program: Program, state: TrainState) -> SacState:
    """Returns the learner after an epoch's updates."""
    return program.learner.learn(state.learner, state.replay, state.key)[0]


def repeat(step: Step, carried: Any) -> Callable[[], None]:
    """Returns a call that continues from the result of the previous one; `carried` is donated."""

    def run() -> None:
        nonlocal carried
        carried = jax.block_until_ready(step(carried))

    return run


def epoch_run(program: Program, state: TrainState) -> Callable[[], None]:
    """Returns a call that trains for an epoch as a run does; `state`, leaves [seeds, …], is donated."""
    compiled = compile_program(program, training.seed_keys(program.config))
    return repeat(lambda state: train_epochs(compiled, state, 1)[0], state)


def contenders(program: Program, start: Callable[[], TrainState]) -> dict[str, Callable[[], Any]]:
    """Returns a call for each part of an epoch and for the whole; leaves are [seeds, …]."""
    compiled = partial(jax.jit, compiler_options=runtime.compiler_options())
    state = start()
    rolled_out, updated = (compiled(jax.vmap(partial(part, program))) for part in (collect, update))
    transitions = rolled_out(state)
    add = compiled(jax.vmap(replay.add), donate_argnums=0)
    rings: Replay = jax.tree.map(jnp.copy, state.replay)
    return {
        "collect": lambda: jax.block_until_ready(rolled_out(state)),
        "add": repeat(lambda buffer: add(buffer, transitions), rings),
        "update": lambda: jax.block_until_ready(updated(state)),
        "whole": epoch_run(program, start()),
    }


def measure(options: argparse.Namespace, config: Config, repeats: int) -> None:
    program = training.make_program(config)

    def start() -> TrainState:
        return jax.jit(jax.vmap(partial(filled, program)))(training.seed_keys(config))

    timings = common.alternate(contenders(program, start), repeats)
    sums = [sum(timings[part].seconds[index] for part in PARTS) for index in range(repeats)]
    row: dict[str, Any] = {
        "preset": config.preset,
        "family": config.family,
        "engine": program.family.engine.name,
        "backend": jax.default_backend(),
        "env_steps": program.env_steps_per_epoch,
        "updates": config.sac.updates,
        "repeats": repeats,
    }
    for part, timing in timings.items():
        row.update(common.spread(f"{part}_seconds", timing.seconds))
    row.update(common.spread("ratio_to_parts", common.ratios(timings["whole"].seconds, sums)))
    common.write_row(options, "chunk", row)


def main() -> None:
    options = common.arguments(__doc__)
    for preset in ("fast", "paper"):
        config = preset_config("halfcheetah-vel", preset)
        if options.quick:
            few = dataclasses.replace(config.sac, updates=2)
            config = dataclasses.replace(config, sac=few)
        measure(options, config, 1 if options.quick else 5)


if __name__ == "__main__":
    sys.exit(exit_code("chunk", main))
