"""Metaworld-Reach: a robot arm brings its gripper to a commanded place."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from ear_jax.envs.angle import AngleFamily
from ear_jax.envs.family import Outcome
from ear_jax.physics import Motion, Physics
from ear_jax.physics.kinematics import body_points
from ear_jax.physics.sawyer import HAND_START, draw_arm, load_arm
from ear_jax.tasks import Task, TaskParams

CENTRE, RADII = (0.0, 0.85, 0.175), (0.1, 0.125)  # metres: the widest upright ellipse in Meta-World's box of goals
NEAR = 0.05  # metres from a goal, where the reward is full
HAND_LOW, HAND_HIGH = (-0.5, 0.4, 0.05), (0.5, 1.0, 0.5)  # metres: where the hand may be led
STRIDE = 0.01  # metres by which an action of 1 leads it on in a step
OPEN = 0.1  # metres between the fingers of an open gripper
SETTLING = 50  # steps in which the hand is led to its start


class Reach(AngleFamily):
    """Reward 10 / (1 + 9 (max(d − 0.05, 0) / m)²) a step, Meta-World's reach-v3 (metaworld 3.0.0); nothing fails.

    d is how far the middle of the fingertips is from the goal, m how far the goal is from where the hand starts, both
    in metres. Meta-World draws goals from a box, and the paper does not say which it took. Ours lie on an upright
    ellipse in that box, 36 degrees apart, so that between two of them there is another. What is seen is the hand and
    how far the gripper is open, not the goal. Meta-World shows the last step beside it (`network.history` 2), and a
    puck and constants, which are left out.
    """

    name = "reach"
    substeps = 5
    mjx_solver = (2, 4)  # exact in C; MJX lacks a term of the weld's reference acceleration
    commanded = "angle"
    prefix, spacing, unseen = "goal-", 36, 3
    # Meta-World shows two steps at once. Its rewards are up to 10, where those of the others are about 1.
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "paper": {"network": {"history": 2}},
        "fast": {"network": {"history": 2}, "sac": {"reward_scale": 0.01, "lr_decay": 40_000}, "epochs": 100},
        "smoke": {"network": {"history": 2}, "sac": {"reward_scale": 0.01}, "tasks": ("0", "108", "216")},
    }

    def __init__(self, engine: str = "auto", task: Task | None = None, **options: Any):
        super().__init__(engine, task, **options)
        bodies = [(body, np.zeros(3)) for body in ("hand", "rightclaw", "leftclaw")]
        tips = [(f"{side}claw", self.model.site(f"{side}EndEffector").pos) for side in ("right", "left")]
        self._points = body_points(self.model, [*bodies, *tips])
        self._settled = _settle(self.model)

    def load(self) -> mujoco.MjModel:
        return load_arm()

    def portrait(self) -> mujoco.MjModel:
        return draw_arm()

    def at(self, angle: float) -> Task:
        """Reach the point of the ellipse at `angle` degrees, counted from the robot's right and upward."""
        across, up = RADII[0] * math.cos(math.radians(angle)), RADII[1] * math.sin(math.radians(angle))
        goal = (CENTRE[0] + across, CENTRE[1], CENTRE[2] + up)
        params = {**dict(zip("xyz", goal, strict=True)), "margin": math.dist(goal, HAND_START)}
        return Task(f"goal-{angle:g}", target=float(angle), params=params)

    def initial(self, key: jax.Array) -> Physics:
        """Always the same, as in Meta-World."""
        return self._settled

    def actuate(self, physics: Physics, action: jax.Array) -> tuple[Physics, jax.Array]:
        """Leads the hand by the first three numbers, and closes (1) or opens (−1) the gripper by the fourth."""
        assert physics.mocap is not None
        led = jnp.clip(physics.mocap + STRIDE * action[:3], jnp.array(HAND_LOW), jnp.array(HAND_HIGH))
        return dataclasses.replace(physics, mocap=led), jnp.stack([action[3], -action[3]])

    @property
    def action_size(self) -> int:
        return 4

    def observe(self, physics: Physics) -> jax.Array:
        hand, right, left, *_ = self._points(physics.qpos)
        return jnp.append(hand, jnp.clip(jnp.linalg.norm(right - left) / OPEN, 0, 1))

    def outcome(self, motion: Motion) -> Outcome:
        *_, right, left = self._points(motion.after.qpos)
        return dict(zip("xyz", (right + left) / 2, strict=True))

    def reward(self, outcome: Outcome, task: TaskParams) -> jax.Array:
        distance = jnp.sqrt(sum((outcome[axis] - task[axis]) ** 2 for axis in "xyz"))
        return 10 / (1 + 9 * (jnp.maximum(distance - NEAR, 0) / task["margin"]) ** 2)

    def achieved(self, late: Outcome, whole: Outcome) -> jax.Array:
        """Where round the ellipse's middle the fingertips were, degrees in [0, 360)."""
        across, up = (late["x"] - CENTRE[0]) / RADII[0], (late["z"] - CENTRE[2]) / RADII[1]
        return jnp.degrees(jnp.arctan2(up, across)) % 360


def _settle(model: mujoco.MjModel) -> Physics:
    """The arm after its hand was led to where it starts, the gripper open."""
    data = mujoco.MjData(model)
    for _ in range(SETTLING):
        data.mocap_pos[:], data.ctrl[:] = HAND_START, (-1, 1)
        mujoco.mj_step(model, data, Reach.substeps)
    state = (data.qpos, data.qvel, data.qacc_warmstart, data.mocap_pos)
    return Physics(*(jnp.array(np.float32(field)) for field in state))


FAMILY = Reach
