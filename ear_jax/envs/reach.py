"""Metaworld-Reach: a robot arm moves its gripper to a commanded point."""

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
from ear_jax.physics.sawyer import HAND_START, arm, draw_arm, load_arm
from ear_jax.tasks import Task, TaskParams

CENTRE, RADII = (0.0, 0.85, 0.175), (0.1, 0.125)  # metres: the largest upright ellipse within Meta-World's box of goals
NEAR = 0.05  # metres from the goal within which the reward is full
HAND_LOW, HAND_HIGH = (-0.5, 0.4, 0.05), (0.5, 1.0, 0.5)  # metres: limits on the hand's commanded position
STRIDE = 0.01  # metres per step that an action of 1 moves the commanded position
OPEN = 0.1  # metres between the fingers when open
SETTLING = 50  # steps to move the hand to its start


class Reach(AngleFamily):
    """Reward 10 / (1 + 9 (max(d − 0.05, 0) / m)²) a step, Meta-World's reach-v3 (metaworld 3.0.0); nothing fails.

    d is the distance from the midpoint of the fingertips to the goal, m that from the hand's start to the goal, both in
    metres. Meta-World draws goals from a box, and the paper does not list its own. Ours lie on an upright ellipse in
    that box, 36 degrees apart, so that the angles between two goals are goals too. The observation is the hand's
    position and the gripper's opening, without the goal. Meta-World adds the previous step's (`network.history` 2), and
    a puck and constants that are left out here.
    """

    name = "reach"
    substeps = 5
    mjx_solver = (2, 4)  # C MuJoCo is exact; MJX lacks a term of the weld's reference acceleration
    commanded = "angle"
    prefix, spacing, unseen = "goal-", 36, 3
    # Meta-World shows two steps at once. Its rewards reach 10; those of the other families are about 1.
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

    def source(self) -> str:
        return arm().to_xml()

    def portrait(self) -> mujoco.MjModel:
        return draw_arm()

    def at(self, angle: float) -> Task:
        """Returns the task to reach the ellipse's point at `angle` degrees, from the robot's right and upward."""
        across, up = RADII[0] * math.cos(math.radians(angle)), RADII[1] * math.sin(math.radians(angle))
        goal = (CENTRE[0] + across, CENTRE[1], CENTRE[2] + up)
        params = {**dict(zip("xyz", goal, strict=True)), "margin": math.dist(goal, HAND_START)}
        return Task(f"goal-{angle:g}", target=float(angle), params=params)

    def goal(self, task: Task) -> tuple[float, float, float]:
        return task.params["x"], task.params["y"], task.params["z"]

    def initial(self, key: jax.Array) -> Physics:
        """Returns the settled arm, always the same, as in Meta-World."""
        return self._settled

    def actuate(self, physics: Physics, action: jax.Array) -> tuple[Physics, jax.Array]:
        """Moves the hand by the first three numbers; the fourth closes (1) or opens (−1) the gripper."""
        assert physics.mocap is not None
        mocap = jnp.clip(physics.mocap + STRIDE * action[:3], jnp.array(HAND_LOW), jnp.array(HAND_HIGH))
        return dataclasses.replace(physics, mocap=mocap), jnp.stack([action[3], -action[3]])

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
        """Returns the fingertips' angle around the ellipse's centre, degrees in [0, 360)."""
        across, up = (late["x"] - CENTRE[0]) / RADII[0], (late["z"] - CENTRE[2]) / RADII[1]
        return jnp.degrees(jnp.arctan2(up, across)) % 360


def _settle(model: mujoco.MjModel) -> Physics:
    """Returns the state after the hand was moved to its start with the gripper open."""
    data = mujoco.MjData(model)
    for _ in range(SETTLING):
        data.mocap_pos[:], data.ctrl[:] = HAND_START, (-1, 1)
        mujoco.mj_step(model, data, Reach.substeps)
    state = (data.qpos, data.qvel, data.qacc_warmstart, data.mocap_pos)
    return Physics(*(jnp.array(np.float32(field)) for field in state))


FAMILY = Reach
