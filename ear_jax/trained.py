"""A finished or unfinished run as those see it who only use its policy."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import jax

from ear_jax import checkpoint, records, train
from ear_jax.config import from_dict
from ear_jax.errors import RunError
from ear_jax.networks import Params
from ear_jax.train import Program


@dataclass(frozen=True)
class Trained:
    """A run's newest policies, one a seed."""

    name: str  # as the user wrote it
    program: Program
    policies: Params  # each leaf [seeds, …]
    epoch: int


def load(directory: Path) -> Trained:
    """Reads a run's newest checkpoint, and of it only the policies.

    Raises:
      UsageError: there is no run.
      RunError: it has no checkpoint yet.
    """
    config = from_dict(records.read_run(directory)["config"])
    steps = checkpoint.steps(directory / "checkpoints")
    if not steps:
        raise RunError(f"{directory} has no checkpoint yet; the same `ear train` command continues it")
    program = train.make_program(config)
    like = jax.eval_shape(jax.vmap(partial(train.init, program)), train.seed_keys(config))
    nothing = jax.tree.map(lambda _: False, like)
    policies = jax.tree.map(lambda _: True, like.learner.policy)
    only = replace(nothing, learner=replace(nothing.learner, policy=policies))
    state = checkpoint.restore(directory / "checkpoints", steps[-1], like, only)
    return Trained(str(directory), program, state.learner.policy, steps[-1])
