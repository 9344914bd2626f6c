"""The interface between the training program and a learner: SAC, PEARL or MAML."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar, Protocol

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

from ear_jax.agents import Agent
from ear_jax.config import Config
from ear_jax.envs import Family
from ear_jax.envs.batched_env import EnvState
from ear_jax.process.target import on_accelerator
from ear_jax.tasks import TaskParams

Metrics = dict[str, jax.Array]


def scan_metrics(step: Callable[[Any, Any], tuple[Any, Metrics]], state: Any, inputs: Any) -> tuple[Any, Metrics]:
    """Scans a step over inputs, and stacks its metrics as `jax.lax.scan` does.

    On an accelerator all metrics of a step are written as one vector: a write of a few numbers takes as long as a
    small matmul.
    """
    if not on_accelerator():
        return jax.lax.scan(step, state, inputs)
    first = jax.tree.map(lambda leaf: leaf[0], inputs)
    shapes = jax.eval_shape(step, state, first)[1]
    unpack = ravel_pytree(jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes))[1]

    def packed(state: Any, inputs: Any) -> tuple[Any, jax.Array]:
        state, metrics = step(state, inputs)
        return state, ravel_pytree(metrics)[0]

    state, vectors = jax.lax.scan(packed, state, inputs)
    return state, jax.vmap(unpack)(vectors)


class Learner(Protocol):
    """Trains one agent on all tasks of a family. States are pytrees; every method except `check` is traced."""

    def __init__(self, agent: Agent, family: Family, tasks: TaskParams, config: Config): ...

    on_policy: ClassVar[bool]  # an update learns from all steps of its epoch and from no others

    @property
    def agent(self) -> Agent: ...

    @staticmethod
    def check(config: Config, tasks: int) -> None:
        """Raises UsageError for settings that cannot train `tasks` tasks."""

    def init(self, key: jax.Array) -> Any:
        """Returns the state that updates change; it has the attributes `policy` and `norms` (scalars by name)."""

    def memory(self, env_states: EnvState) -> Any:
        """Returns empty storage for the experience of environments [tasks, envs]."""

    def collect(self, state: Any, memory: Any, env_states: EnvState, key: jax.Array) -> tuple[EnvState, Any, Metrics]:
        """Steps every task's environments through an epoch and stores their experience."""
        ...

    def learn(self, state: Any, memory: Any, key: jax.Array) -> tuple[Any, Metrics]:
        """Makes an epoch's updates; `finite_updates` [tasks] counts those before a task's first non-finite loss."""
        ...
