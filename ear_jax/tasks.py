"""Tasks of a family: names, targets and the numbers their rewards read, stacked for many tasks."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp

from ear_jax.errors import UsageError, unknown

TaskParams = dict[str, jax.Array]


def task_count(params: TaskParams) -> int:
    """Returns the number of tasks stacked in `params`, each leaf [tasks]."""
    return len(jax.tree.leaves(params)[0])


def any_task(params: TaskParams, rows: int = 1) -> TaskParams:
    """Returns the first task for every row, each leaf [rows]: for roll-outs whose rewards are not used."""
    return {name: jnp.broadcast_to(leaf[0], rows) for name, leaf in params.items()}


@dataclass(frozen=True)
class Task:
    """One task of a family: its name, its commanded value and the numbers its reward reads."""

    name: str
    target: float | None  # in the family's unit; None if the task commands no value, as for a jump
    params: dict[str, float]


@dataclass(frozen=True)
class TaskSet:
    """Tasks in the order of their one-hots."""

    tasks: tuple[Task, ...]

    def __len__(self) -> int:
        return len(self.tasks)

    @property
    def names(self) -> list[str]:
        return [task.name for task in self.tasks]

    @property
    def targets(self) -> list[float | None]:
        return [task.target for task in self.tasks]

    @property
    def params(self) -> TaskParams:
        """The numbers the reward reads, each leaf [tasks]; empty without tasks."""
        if not self.tasks:
            return {}
        leaves = (task.params for task in self.tasks)
        stacked: TaskParams = jax.tree.map(lambda *values: jnp.asarray(values, jnp.float32), *leaves)
        return stacked

    @property
    def document(self) -> list[dict[str, Any]]:
        """The tasks as a JSON document."""
        return [dataclasses.asdict(task) for task in self.tasks]

    @property
    def fingerprint(self) -> str:
        """SHA-256 of names, targets and numbers in order; sets with equal fingerprints number their tasks alike."""
        return hashlib.sha256(json.dumps(self.document, sort_keys=True).encode()).hexdigest()

    def index(self, name: str) -> int:
        """Returns a task's position by its name; raises UsageError if there is none."""
        if name not in self.names:
            raise unknown("task", name, self.names)
        return self.names.index(name)


def task_set(tasks: Sequence[Task]) -> TaskSet:
    """Builds a set of at least one task, each given once.

    Raises:
      UsageError: there is no task, or one is given twice.
    """
    names = [task.name for task in tasks]
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise UsageError(f"task {repeated[0]!r} is given twice")
    if not tasks:
        raise UsageError("a task set needs at least one task")
    return TaskSet(tuple(tasks))
