"""Tasks: what tells one from another is a pytree of numbers, and many of them are that pytree stacked."""

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


@dataclass(frozen=True)
class Task:
    """One task of a family: its name, the number a person commands, and the numbers its reward reads."""

    name: str
    target: float | None  # None where nothing is commanded, only more is better
    params: dict[str, float]


@dataclass(frozen=True)
class TaskSet:
    """Tasks in the order of their one-hot codes."""

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
        """The reward's numbers, each leaf [tasks]; nothing for no tasks."""
        if not self.tasks:
            return {}
        return jax.tree.map(lambda *leaves: jnp.asarray(leaves, jnp.float32), *(task.params for task in self.tasks))

    @property
    def document(self) -> list[dict[str, Any]]:
        """The tasks as JSON holds them."""
        return [dataclasses.asdict(task) for task in self.tasks]

    @property
    def fingerprint(self) -> str:
        """SHA-256 of names, targets and numbers, in order: where two agree, the same code means the same task."""
        return hashlib.sha256(json.dumps(self.document, sort_keys=True).encode()).hexdigest()

    def index(self, name: str) -> int:
        if name not in self.names:
            raise unknown("task", name, self.names)
        return self.names.index(name)


def task_set(tasks: Sequence[Task]) -> TaskSet:
    """A set of at least one task, none twice.

    Raises:
      UsageError: no task, or a task given twice.
    """
    names = [task.name for task in tasks]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise UsageError(f"task {twice[0]!r} is given twice")
    if not tasks:
        raise UsageError("a task set needs at least one task")
    return TaskSet(tuple(tasks))
