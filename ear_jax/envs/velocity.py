"""Tasks that command a forward speed, shared by the families that do."""

from __future__ import annotations

import math
from collections.abc import Iterable

import jax
import jax.numpy as jnp

from ear_jax.errors import UsageError
from ear_jax.physics import Motion
from ear_jax.tasks import Task, TaskSet, task_set


def velocity_task(speed: float) -> Task:
    """Run at `speed` metres per second; 2 m/s is called vel-2."""
    return Task(name=f"vel-{speed:g}", target=speed, params={"velocity": speed})


def velocity_tasks(speeds: Iterable[float]) -> TaskSet:
    return task_set([velocity_task(speed) for speed in speeds])


def parse_velocity_task(text: str) -> Task:
    """A task from `2`, `2.5`, `vel-2.5` or `2.5m/s`.

    Raises:
      UsageError: it is none of these.
    """
    try:
        speed = float(text.strip().lower().removeprefix("vel-").removesuffix("m/s").strip())
    except ValueError:
        speed = math.nan
    if not math.isfinite(speed):
        raise UsageError(f"no task {text!r}; name a speed in metres per second, as in 2.5 or vel-2.5")
    return velocity_task(speed)


def forward_velocity(motion: Motion, dt: float) -> jax.Array:
    """Mean forward speed over the step, m/s, from how far the root moved."""
    return (motion.after.qpos[0] - motion.before.qpos[0]) / dt


def squared_action(motion: Motion) -> jax.Array:
    """Σ a², what control costs are a multiple of."""
    return jnp.sum(motion.action**2)
