"""Families whose tasks command a forward speed."""

from __future__ import annotations

import math
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from ear_jax.envs.family import Family, Outcome
from ear_jax.errors import UsageError
from ear_jax.physics import Motion, Physics
from ear_jax.tasks import Task, TaskParams, TaskSet, task_set


class VelocityFamily(Family):
    """Reward `alive_bonus` − |v − v*| − `control_cost` Σa² a step, v in m/s along x (paper, appendix B.1)."""

    commanded, unit = "velocity", "m/s"
    speeds: ClassVar[tuple[float, ...]]  # v* of the training tasks in m/s, ascending and evenly spaced
    adaptation_range: ClassVar[tuple[float, float]]  # m/s, range of the adaptation tasks
    alive_bonus: ClassVar[float] = 0.0
    control_cost: ClassVar[float]

    def training_tasks(self) -> TaskSet:
        return task_set([velocity_task(speed) for speed in self.speeds])

    def spread_tasks(self, count: int) -> TaskSet:
        """Returns tasks at equal steps from standing, which is left out, to the largest speed."""
        return task_set([velocity_task(self.speeds[-1] * step / count) for step in range(1, count + 1)])

    def adaptation_tasks(self, seed: int) -> TaskSet:
        speeds = np.random.default_rng(seed).uniform(*self.adaptation_range, size=3)
        return task_set([velocity_task(float(speed)) for speed in speeds])

    def parse_task(self, text: str) -> Task:
        """Returns a task from `2`, `2.5`, `vel-2.5` or `2.5m/s`."""
        try:
            speed = float(text.strip().lower().removeprefix("vel-").removesuffix("m/s").strip())
        except ValueError:
            speed = math.nan
        if not math.isfinite(speed):
            raise UsageError(f"no task {text!r}; name a speed in metres per second, as in 2.5 or vel-2.5")
        return velocity_task(speed)

    def outcome(self, motion: Motion) -> Outcome:
        return {"velocity": forward_velocity(motion, self.dt), "squared_action": jnp.sum(motion.action**2)}

    def reward(self, outcome: Outcome, task: TaskParams) -> jax.Array:
        tracking = jnp.abs(outcome["velocity"] - task["velocity"])
        return self.alive_bonus - tracking - self.control_cost * outcome["squared_action"]


# A step is 8 ms, a sixth of the cheetah's. A discount of 0.98 would look only 0.4 s ahead, less than a hop.
_LONG_HORIZON: dict[str, Any] = {"sac": {"discount": 0.99}}
LEGGED_PRESETS: dict[str, dict[str, Any]] = {
    "paper": {"epochs": 5000},
    "fast": _LONG_HORIZON,
    "smoke": {**_LONG_HORIZON, "tasks": ("0.4", "1", "1.6")},
}


class LeggedVelocityFamily(VelocityFamily):
    """The base of Hopper-Vel and Walker-Vel: starts near the upright pose, and clipped speeds in observations."""

    substeps = 4
    speeds = tuple(round(0.2 * step, 1) for step in range(1, 11))
    adaptation_range = (0.2, 2.0)
    control_cost = 0.001

    def initial(self, key: jax.Array) -> Physics:
        return self.noisy_start(
            key, 0.005, lambda key, shape: jax.random.uniform(key, shape, minval=-0.005, maxval=0.005)
        )

    def observe(self, physics: Physics) -> jax.Array:
        return jnp.concatenate([physics.qpos[1:], jnp.clip(physics.qvel, -10, 10)])


def velocity_task(speed: float) -> Task:
    """Returns the task to run at `speed` metres per second, vel-2 for 2 m/s."""
    speed = round(speed, 6)
    return Task(name=f"vel-{speed:g}", target=float(speed), params={"velocity": speed})


def forward_velocity(motion: Motion, dt: float) -> jax.Array:
    """Returns the mean forward speed over a step in m/s, from the root's displacement."""
    return (motion.after.qpos[0] - motion.before.qpos[0]) / dt
