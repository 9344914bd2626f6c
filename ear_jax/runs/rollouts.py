"""Memory of simulations that are rolled out at once, from shapes and before any is allocated."""

from __future__ import annotations

import jax

from ear_jax.errors import RunError
from ear_jax.process import runtime
from ear_jax.process.memory import available
from ear_jax.runs.training import Program


def rollout_bytes(program: Program, simulations: int, steps: int, extra: int = 0) -> int:
    """Returns a lower bound of the memory that simulations take while they are rolled out.

    Args:
      program: the family and the agent.
      simulations: number of simulations, of all seeds together.
      steps: environment steps of each.
      extra: further numbers that each step records.
    """
    family = program.family
    key = jax.eval_shape(lambda: jax.random.key(0))
    task = jax.eval_shape(lambda: jax.tree.map(lambda leaf: leaf[0], program.tasks.params))
    state = jax.eval_shape(family.start, key, task)
    recorded = family.action_size + len(state.metrics) + extra  # noise and outcomes
    return simulations * (2 * runtime.tree_bytes(state) + 4 * steps * recorded)


def epoch_bytes(program: Program) -> int:
    """Returns what an epoch takes beside the state: a roll-out, or the random numbers of its updates if more."""
    config, tasks = program.config, program.config.seeds * len(program.tasks)
    collecting = rollout_bytes(program, tasks * config.collect.envs, config.collect.steps)
    evaluating = rollout_bytes(program, tasks * config.log.episodes, program.family.episode_length)
    items = config.seeds * config.sac.updates * config.sac.batch_size
    drawn = (
        0 if program.learner.on_policy else 4 * items * (2 * (program.family.action_size + program.agent.code_size) + 3)
    )
    return max(collecting, evaluating, drawn)


def check_rollouts(program: Program, simulations: int, steps: int, extra: int = 0) -> None:
    """Raises RunError, with the sizes, if simulations do not fit in memory; arguments as in `rollout_bytes`."""
    needed = rollout_bytes(program, simulations, steps, extra)
    room = min(available(), key=lambda room: room.bytes, default=None)
    if room is not None and needed > room.bytes:
        free = max(0, room.bytes)
        raise RunError(
            f"{simulations:,} simulations of {steps:,} steps at once need {needed / 1e9:.2f} GB of memory, but only "
            f"{free / 1e9:.2f} GB is free under {room.limit}, enough for about {free * simulations // needed:,}; "
            "ask for fewer episodes, samples, places, β or steps"
        )
