"""Families with known answers, on a physics of one sliding mass."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import mujoco

from ear_jax.envs import Family
from ear_jax.envs.family import Outcome
from ear_jax.physics import Motion, Physics
from ear_jax.tasks import Task, TaskParams, TaskSet, task_set

SLIDER = """
<mujoco>
  <option timestep="0.01" gravity="0 0 0"/>
  <worldbody><body><joint name="slide" type="slide" axis="1 0 0"/><geom size="0.1" mass="1"/></body></worldbody>
  <actuator><motor joint="slide" ctrlrange="-1 1" ctrllimited="true"/></actuator>
</mujoco>
"""

TABLE = """
<mujoco>
  <option timestep="0.05" gravity="0 0 0"/>
  <worldbody>
    <body>
      <joint name="x" type="slide" axis="1 0 0"/><joint name="y" type="slide" axis="0 1 0"/><geom size="0.1" mass="1"/>
    </body>
  </worldbody>
  <actuator>
    <motor joint="x" ctrlrange="-1 1" ctrllimited="true"/><motor joint="y" ctrlrange="-1 1" ctrllimited="true"/>
  </actuator>
</mujoco>
"""


class Bandit(Family):
    """Episodes of one step with the reward −(a − a*)². Observations are the same in all tasks: only codes differ."""

    name = "bandit"
    substeps = 1
    mjx_solver = (1, 1)
    commanded, unit = "action", "1"
    targets = (-0.5, 0.5)

    def load(self) -> mujoco.MjModel:
        return mujoco.MjModel.from_xml_string(SLIDER)

    def training_tasks(self) -> TaskSet:
        return task_set([self.parse_task(str(target)) for target in self.targets])

    def parse_task(self, text: str) -> Task:
        return Task(name=text, target=float(text), params={"action": float(text)})

    def initial(self, key: jax.Array) -> Physics:
        return Physics(jax.random.uniform(key, (1,)), jnp.zeros(1), jnp.zeros(1))

    def observe(self, physics: Physics) -> jax.Array:
        return jnp.ones(1) + 0 * physics.qpos

    def outcome(self, motion: Motion) -> Outcome:
        return {"action": motion.action[0]}

    def reward(self, outcome: Outcome, task: TaskParams) -> jax.Array:
        return -((outcome["action"] - task["action"]) ** 2)

    def terminated(self, physics: Physics) -> jax.Array:
        return jnp.ones((), bool)


class Slider(Bandit):
    """Episodes of up to 4 steps that fail past x = 2; observes position and speed."""

    name = "slider"
    episode_length = 4

    def observe(self, physics: Physics) -> jax.Array:
        return jnp.concatenate([physics.qpos, physics.qvel])

    def terminated(self, physics: Physics) -> jax.Array:
        return physics.qpos[0] > 2


class Recall(Slider):
    """Shows a cue, the mass's start, at the first step only; at every step the best action is half of it."""

    name = "recall"

    def initial(self, key: jax.Array) -> Physics:
        return Physics(jax.random.rademacher(key, (1,), jnp.float32), jnp.zeros(1), jnp.zeros(1))

    def observe(self, physics: Physics) -> jax.Array:
        return jnp.where(physics.qvel == 0, physics.qpos, 0.0)

    def outcome(self, motion: Motion) -> Outcome:
        return {"action": motion.action[0], "cue": jnp.sign(motion.before.qpos[0])}

    def reward(self, outcome: Outcome, task: TaskParams) -> jax.Array:
        return -((outcome["action"] - 0.5 * outcome["cue"]) ** 2)


class Point(Bandit):
    """The point of Finn et al. (2017): from the origin, by up to 0.1 a step, with the reward −distance from a goal."""

    name = "point"
    episode_length = 50
    goals = ((-0.5, -0.5), (-0.5, 0.5), (0.5, -0.5), (0.5, 0.5))

    def load(self) -> mujoco.MjModel:
        return mujoco.MjModel.from_xml_string(TABLE)

    def training_tasks(self) -> TaskSet:
        return task_set([Task(name=f"{x} {y}", target=x, params={"x": x, "y": y}) for x, y in self.goals])

    def initial(self, key: jax.Array) -> Physics:
        return Physics(0.01 * jax.random.normal(key, (2,)), jnp.zeros(2), jnp.zeros(2))

    def actuate(self, physics: Physics, action: jax.Array) -> tuple[Physics, jax.Array]:
        return replace(physics, qvel=0.1 * action / self.dt), jnp.zeros(2)

    def observe(self, physics: Physics) -> jax.Array:
        return physics.qpos

    def outcome(self, motion: Motion) -> Outcome:
        return {"action": motion.action[0], "x": motion.after.qpos[0], "y": motion.after.qpos[1]}

    def reward(self, outcome: Outcome, task: TaskParams) -> jax.Array:
        return -jnp.hypot(outcome["x"] - task["x"], outcome["y"] - task["y"])

    def terminated(self, physics: Physics) -> jax.Array:
        return jnp.zeros((), bool)


class Clock(Bandit):
    """Episodes of 20 steps that show the time, from 0 to 1; up to 0.2 the best action is a*, and −a* from then on."""

    name = "clock"
    episode_length = 20

    def initial(self, key: jax.Array) -> Physics:
        return Physics(jnp.zeros(1), jnp.zeros(1), jnp.zeros(1))

    def actuate(self, physics: Physics, action: jax.Array) -> tuple[Physics, jax.Array]:
        # The force of the action changes the next time by 1e-4 at most.
        return replace(physics, qvel=jnp.full(1, 1 / (self.episode_length * self.dt))), action

    def observe(self, physics: Physics) -> jax.Array:
        return physics.qpos

    def outcome(self, motion: Motion) -> Outcome:
        return {"action": motion.action[0], "time": motion.before.qpos[0]}

    def reward(self, outcome: Outcome, task: TaskParams) -> jax.Array:
        best = jnp.where(outcome["time"] < 0.199, task["action"], -task["action"])
        return -((outcome["action"] - best) ** 2)

    def terminated(self, physics: Physics) -> jax.Array:
        return jnp.zeros((), bool)
