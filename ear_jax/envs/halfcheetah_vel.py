"""HalfCheetah-Vel: a planar cheetah runs forward at a commanded speed."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from ear_jax.envs.family import Family, Outcome
from ear_jax.envs.velocity import forward_velocity, parse_velocity_task, squared_action, velocity_tasks
from ear_jax.physics import Motion, Physics
from ear_jax.tasks import Task, TaskParams, TaskSet


class HalfCheetahVel(Family):
    """Reward −|v − v*| − 0.1 Σa² a step, v* = 1 … 10 m/s; it never terminates (paper, appendix B.1; Gym v2 physics)."""

    name = "halfcheetah-vel"
    model_file = "half_cheetah.xml"
    substeps = 5
    commanded, unit = "velocity", "m/s"
    # One step from random states against C MuJoCo: median error 3e-8 in qpos, as with the model's own 100 and 50.
    mjx_solver = (4, 8)

    def training_tasks(self) -> TaskSet:
        return velocity_tasks(range(1, 11))

    def parse_task(self, text: str) -> Task:
        return parse_velocity_task(text)

    def initial(self, key: jax.Array) -> Physics:
        key_qpos, key_qvel = jax.random.split(key)
        qpos = self.model.qpos0 + jax.random.uniform(key_qpos, (self.model.nq,), minval=-0.1, maxval=0.1)
        qvel = 0.1 * jax.random.normal(key_qvel, (self.model.nv,))
        return Physics(qpos.astype(jnp.float32), qvel, jnp.zeros(self.model.nv))

    def observe(self, physics: Physics) -> jax.Array:
        return jnp.concatenate([physics.qpos[1:], physics.qvel])

    def outcome(self, motion: Motion) -> Outcome:
        return {"velocity": forward_velocity(motion, self.dt), "squared_action": squared_action(motion)}

    def reward(self, outcome: Outcome, task: TaskParams) -> jax.Array:
        return -jnp.abs(outcome["velocity"] - task["velocity"]) - 0.1 * outcome["squared_action"]
