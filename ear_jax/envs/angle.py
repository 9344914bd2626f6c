"""Families whose tasks command an angle."""

from __future__ import annotations

import abc
import math
from typing import ClassVar

import numpy as np

from ear_jax.envs.family import Family
from ear_jax.errors import UsageError
from ear_jax.tasks import Task, TaskSet, task_set


class AngleFamily(Family):
    """A family whose training tasks are evenly spaced angles around the circle."""

    unit, period = "degrees", 360.0
    prefix: ClassVar[str]  # of a task's name; its angle follows
    spacing: ClassVar[int]  # degrees between training tasks
    unseen: ClassVar[int]  # number of adaptation tasks

    @abc.abstractmethod
    def at(self, angle: float) -> Task:
        """Returns the task of an angle in [0, 360) degrees."""

    def training_tasks(self) -> TaskSet:
        return task_set([self.at(angle) for angle in range(0, 360, self.spacing)])

    def spread_tasks(self, count: int) -> TaskSet:
        """Returns tasks at equal angles around the circle, from 0."""
        return task_set([self.at(round(360 * step / count, 6)) for step in range(count)])

    def adaptation_tasks(self, seed: int) -> TaskSet:
        rng = np.random.default_rng(seed)
        angles = rng.choice(360, size=self.unseen, replace=False)
        while (angles % self.spacing == 0).any():  # no training task among them
            angles = rng.choice(360, size=self.unseen, replace=False)
        return task_set([self.at(int(angle)) for angle in angles])

    def parse_task(self, text: str) -> Task:
        """Returns a task from `45`, `45deg` or its name; angles wrap at 360."""
        number = text.strip().lower().removeprefix(self.prefix)
        try:
            angle = float(number.removesuffix("degrees").removesuffix("deg").removesuffix("°").strip())
        except ValueError:
            angle = math.nan
        if not math.isfinite(angle):
            raise UsageError(f"no task {text!r}; name an angle in degrees, as in 45 or {self.prefix}45")
        return self.at(angle % 360)
