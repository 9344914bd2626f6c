"""Ant-Dir: a four-legged ant runs as fast as it can in a commanded direction."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar

import jax
import jax.numpy as jnp

from ear_jax.envs.angle import AngleFamily
from ear_jax.envs.family import Outcome
from ear_jax.envs.symmetry import Symmetry, turns_and_flips
from ear_jax.physics import Motion, Physics
from ear_jax.tasks import Task, TaskParams

# Signed permutations by a quarter turn to the left, and by a mirror image that exchanges left and right
# (`turns_and_flips`). Legs are in the model's order, hip and ankle each; neighbouring ankles bend about opposite axes.
_LEGS = ((7, 8, 1, -2, 3, 4, 5, -6), (-7, 8, -5, 6, -3, 4, -1, 2))
_MOTORS = ((7, -8, 1, 2, 3, -4, 5, 6), (-3, 4, -1, 2, -7, 8, -5, 6))  # leg 4's motors come first
_HEIGHT, _QUATERNION = ((1,), (1,)), ((1, -3, 2, 4), (1, -2, 3, -4))
_VELOCITY, _SPIN, _PLANE = ((-2, 1, 3), (1, -2, 3)), ((-2, 1, 3), (-1, 2, -3)), ((-2, 1), (1, -2))
_OBSERVATION = (_HEIGHT, _QUATERNION, _LEGS, _VELOCITY, _SPIN, _LEGS)


class AntDir(AngleFamily):
    """Reward v·d − c |v·d⊥| − 0.5 Σa² + 1 a step for 24 directions d; fails as Gym's Ant-v2 does.

    The paper's text penalises lateral speed but its code does not; `lateral_weight` is c, 0 by default. Observations
    leave out Ant-v2's contact forces, which were always zero in the authors' software.
    """

    name = "ant-dir"
    model_file = "ant.xml"
    substeps = 5
    # Median error of a step in qpos 1e-7. The largest, 1e-2, occur with a leg within 30° of upright, where MJX and C
    # MuJoCo orient the friction pyramid differently; more iterations do not help.
    mjx_solver = (4, 8)
    commanded = "direction"
    plane = ("velocity_x", "velocity_y")
    prefix, spacing, unseen = "dir-", 15, 5
    options = ("lateral_weight",)
    lateral_weight = 0.0
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "paper": {"epochs": 10_000, "sac": {"batch_size": 1920}, "replay": {"capacity": 1_200_000}},
        # Replay holds 100 epochs, as for the other families. Only a 24th of it comes from a given task, too little to
        # learn speed in its direction, so half of a batch does. The ant's 8 symmetries make 8 transitions of each.
        "fast": {"replay": {"capacity": 480_000, "own_share": 0.5, "symmetry": True}},
        "smoke": {"tasks": ("0", "90", "180", "270")},
    }

    def at(self, angle: float) -> Task:
        """Returns the task to run at `angle` degrees from the x axis, dir-45 for 45 degrees."""
        radians = math.radians(angle)
        return Task(f"dir-{angle:g}", target=float(angle), params={"x": math.cos(radians), "y": math.sin(radians)})

    @property
    def symmetry(self) -> Symmetry:
        """The eight symmetries of a square: quarter turns and their mirror images."""
        observation, motors, plane = (turns_and_flips(parts, 4) for parts in (_OBSERVATION, (_MOTORS,), (_PLANE,)))
        return Symmetry(8, observation, motors, plane, velocity=("velocity_x", "velocity_y"), direction=("x", "y"))

    def initial(self, key: jax.Array) -> Physics:
        return self.noisy_start(key, 0.1, lambda key, shape: 0.1 * jax.random.normal(key, shape))

    def observe(self, physics: Physics) -> jax.Array:
        return jnp.concatenate([physics.qpos[2:], physics.qvel])

    def outcome(self, motion: Motion) -> Outcome:
        velocity = (motion.after.qpos[:2] - motion.before.qpos[:2]) / self.dt
        return {
            "velocity_x": velocity[0],
            "velocity_y": velocity[1],
            "squared_action": jnp.sum(motion.action**2),
        }

    def reward(self, outcome: Outcome, task: TaskParams) -> jax.Array:
        along = outcome["velocity_x"] * task["x"] + outcome["velocity_y"] * task["y"]
        across = outcome["velocity_y"] * task["x"] - outcome["velocity_x"] * task["y"]
        return along - self.lateral_weight * jnp.abs(across) - 0.5 * outcome["squared_action"] + 1.0

    def terminated(self, physics: Physics) -> jax.Array:
        """Returns True if the torso's height is outside 0.2 to 1 m or a number is not finite."""
        height = physics.qpos[2]
        finite = jnp.all(jnp.isfinite(physics.qpos)) & jnp.all(jnp.isfinite(physics.qvel))
        return ~(finite & (height >= 0.2) & (height <= 1.0))

    def achieved(self, late: Outcome, whole: Outcome) -> jax.Array:
        """Returns the angle from the episode's start to its end, degrees in [0, 360)."""
        return jnp.degrees(jnp.arctan2(whole["velocity_y"], whole["velocity_x"])) % 360


FAMILY = AntDir
