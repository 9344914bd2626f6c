"""HalfCheetah-Run-Jump: the cheetah runs backward at a commanded speed, or raises its hind leg, or does both."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import mujoco

from ear_jax.envs.family import Outcome
from ear_jax.envs.halfcheetah_vel import HalfCheetah
from ear_jax.envs.velocity import forward_velocity
from ear_jax.errors import unknown
from ear_jax.physics import Motion
from ear_jax.tasks import Task, TaskParams, TaskSet, task_set

HIND_FOOT = "bfoot"
SPEEDS = range(1, 8)  # m/s, backward
WEIGHTS = (1, 5, 10)  # on height
BOTH = r"both-(\d+\.?\d*)-(\d+\.?\d*)"  # speed in m/s and weight on height


class HalfCheetahRunJump(HalfCheetah):
    """Reward −w_run |v − v*| + w_jump h − 0.1 Σa² a step; tasks are weights on shared terms, never branches.

    h is the height of the hind foot in metres (paper). `jump_height="torso"` is the authors' code: the height of the
    torso above its position at rest.
    """

    name = "halfcheetah-run-jump"
    commanded, unit = "velocity", "m/s"
    options = ("jump_height",)
    jump_height = "hind_foot"
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {"smoke": {"tasks": ("back-1", "back-3", "jump-5")}}

    def load(self) -> mujoco.MjModel:
        if self.jump_height not in ("hind_foot", "torso"):
            raise unknown("jump_height", self.jump_height, ("hind_foot", "torso"))
        self.bodies = (HIND_FOOT,) if self.jump_height == "hind_foot" else ()
        return super().load()

    def training_tasks(self) -> TaskSet:
        return task_set([_back(speed) for speed in SPEEDS] + [_jump(weight) for weight in WEIGHTS])

    def parse_task(self, text: str) -> Task:
        """Returns one of `back-1` … `back-7`, `jump-1`, `jump-5`, `jump-10`, or by nickname: walk, run, stand, jump.

        `both-SPEED-WEIGHT`, as `both-2-5`, rewards running and height at once; no preset but `+both` trains on it.
        """
        if words := re.fullmatch(BOTH, text.strip().lower()):
            return _both(*map(float, words.groups()))
        nicknames = {"walk": "back-1", "run": "back-7", "stand": "jump-1", "jump": "jump-10"}
        tasks = {task.name: task for task in self.training_tasks().tasks}
        name = nicknames.get(text.strip().lower(), text.strip().lower())
        if name not in tasks:
            raise unknown("task", text, (*tasks, *nicknames, "both-2-5"))
        return tasks[name]

    def asks(self, task: Task) -> tuple[str, str]:
        return ("height", "m") if task.target is None else super().asks(task)

    def outcome(self, motion: Motion) -> Outcome:
        height = motion.positions[0, 2] if self.bodies else motion.after.qpos[1]
        return {
            "velocity": forward_velocity(motion, self.dt),
            "height": height,
            "squared_action": jnp.sum(motion.action**2),
        }

    def reward(self, outcome: Outcome, task: TaskParams) -> jax.Array:
        running = task["run"] * jnp.abs(outcome["velocity"] - task["velocity"])
        return task["jump"] * outcome["height"] - running - 0.1 * outcome["squared_action"]


def _back(speed: float) -> Task:
    return Task(f"back-{speed:g}", target=-float(speed), params={"run": 1.0, "velocity": -float(speed), "jump": 0.0})


def _jump(weight: float) -> Task:
    return Task(f"jump-{weight:g}", target=None, params={"run": 0.0, "velocity": 0.0, "jump": float(weight)})


def _both(speed: float, weight: float) -> Task:
    params = {"run": 1.0, "velocity": -speed, "jump": weight}
    return Task(f"both-{speed:g}-{weight:g}", target=-speed, params=params)


FAMILY = HalfCheetahRunJump
