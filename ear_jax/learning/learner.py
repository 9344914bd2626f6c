"""The interface between the training program and a learner: SAC, PEARL or MAML."""

from __future__ import annotations

from typing import Any, ClassVar, Protocol

import jax

from ear_jax.agents import Agent
from ear_jax.config import Config
from ear_jax.envs import Family
from ear_jax.envs.batched_env import EnvState
from ear_jax.tasks import TaskParams

Metrics = dict[str, jax.Array]


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
