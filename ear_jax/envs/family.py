"""What a family of tasks is: one robot, one physics, and many ways to score what it did."""

from __future__ import annotations

import abc
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import mujoco

from ear_jax.envs.symmetry import Symmetry
from ear_jax.errors import UsageError
from ear_jax.physics import Motion, Physics, make_engine
from ear_jax.physics.models import load_model
from ear_jax.process.silent_imports import Env, State
from ear_jax.tasks import Task, TaskParams, TaskSet

Outcome = dict[str, jax.Array]


class Family(Env):
    """A Brax environment of one robot whose tasks share physics and differ in reward.

    Everything is written for one environment. A step's physics yields an `outcome`, a few named scalars, and a task is
    a pytree of numbers by which `reward` scores it: one roll-out can so be scored for any task. A subclass states the
    model and the methods marked abstract, and never branches on a task.

    As a Brax environment: `State.pipeline_state` is a `Physics`, `State.metrics` the outcome, `State.info["task"]` the
    task's numbers and `State.info["key"]` the stream its later resets are drawn from. `reset` starts `task`, by default
    the first training task.
    """

    name: ClassVar[str]
    model_file: ClassVar[str]  # a model of Gymnasium's
    substeps: ClassVar[int]  # MuJoCo steps in one environment step
    mjx_solver: ClassVar[tuple[int, int]]  # solver and line-search iterations of MJX, measured
    bodies: tuple[str, ...] = ()  # bodies whose positions `outcome` reads
    feet: ClassVar[dict[str, str]] = {}  # bodies that touch the ground, by what to call them
    commanded: ClassVar[str]  # the outcome that a task's target commands
    unit: ClassVar[str]  # of the target and of that outcome
    period: ClassVar[float | None] = None  # where that quantity wraps, as directions do at 360
    episode_length: ClassVar[int] = 200  # steps; a time limit, which is no termination

    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {}  # preset → settings it changes for this family

    history: int = 1  # observations shown at once; at a start, the first in place of those before it

    options: ClassVar[tuple[str, ...]] = ()  # attributes that may be set when it is made

    def __init__(self, engine: str = "auto", task: Task | None = None, **options: Any):
        for option, value in options.items():
            setattr(self, option, value)
        self.model = self.load()
        if not isinstance(self.model, mujoco.MjModel):
            raise UsageError(f"load() must return a mujoco.MjModel, and returns {type(self.model).__name__}")
        self.engine = make_engine(engine, self.model, self.substeps, self.bodies, self.mjx_solver)
        self.task = task
        self.dt = float(self.model.opt.timestep) * self.substeps  # seconds in one environment step

    # What a family says.

    def load(self) -> mujoco.MjModel:
        """The robot; by default one of Gymnasium's."""
        return load_model(self.model_file)

    @property
    def symmetry(self) -> Symmetry | None:
        """How a step may be turned or mirrored; by default in no way."""
        return None

    def portrait(self) -> mujoco.MjModel:
        """What pictures show, of the same qpos; by default the model."""
        return self.model

    @abc.abstractmethod
    def training_tasks(self) -> TaskSet:
        """The paper's training tasks, in the order of their one-hot codes."""

    def adaptation_tasks(self, seed: int) -> TaskSet:
        """Tasks not trained on, drawn from a seed; none by default."""
        return TaskSet(())

    @abc.abstractmethod
    def parse_task(self, text: str) -> Task:
        """A task from the words a person uses for it; raises UsageError where there is none."""

    @abc.abstractmethod
    def initial(self, key: jax.Array) -> Physics:
        """A random start."""

    def actuate(self, physics: Physics, action: jax.Array) -> tuple[Physics, jax.Array]:
        """The state to step from, and the control [nu] held meanwhile; by default the action is the control."""
        return physics, action

    @abc.abstractmethod
    def observe(self, physics: Physics) -> jax.Array:
        """What the policy sees of a state, [size]."""

    @abc.abstractmethod
    def outcome(self, motion: Motion) -> Outcome:
        """What the step achieved, as named scalars: all that any task of the family may be scored by."""

    @abc.abstractmethod
    def reward(self, outcome: Outcome, task: TaskParams) -> jax.Array:
        """Scores an outcome for one task; a scalar."""

    def terminated(self, physics: Physics) -> jax.Array:
        """Whether the robot has failed; a scalar bool. By default it cannot."""
        return jnp.zeros((), bool)

    def achieved(self, late: Outcome, whole: Outcome) -> jax.Array:
        """The commanded quantity, from an episode's outcomes averaged over its second half, and over all of it."""
        return late[self.commanded]

    def difference(self, one: Any, other: Any) -> Any:
        """`one` − `other` in the commanded quantity; where that wraps, the shorter way round."""
        if self.period is None:
            return one - other
        return (one - other + self.period / 2) % self.period - self.period / 2

    # What follows from it.

    @property
    def quantity(self) -> dict[str, str]:
        """The commanded quantity and its unit, as documents name them."""
        return {"outcome": self.commanded, "unit": self.unit}

    def noisy_start(self, key: jax.Array, position: float, speed: Callable[..., jax.Array]) -> Physics:
        """The model's own pose, each coordinate moved by U(±position), with speeds drawn by `speed(key, shape)`."""
        key_qpos, key_qvel = jax.random.split(key)
        qpos = jax.random.uniform(key_qpos, (self.model.nq,), minval=-position, maxval=position)
        qpos0 = jnp.asarray(self.model.qpos0, jnp.float32)
        return Physics(qpos0 + qpos, speed(key_qvel, (self.model.nv,)), jnp.zeros(self.model.nv))

    def start(self, key: jax.Array, task: TaskParams) -> State:
        """A random start of one task."""
        key_initial, key_later = jax.random.split(key)
        physics = self.initial(key_initial)
        blank = jax.eval_shape(self.outcome, Motion(physics, *self._still()))
        outcome = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), blank)
        info: dict[str, Any] = {"task": task, "key": key_later}
        return State(physics, self._first_seen(physics), jnp.zeros(()), jnp.zeros(()), outcome, info)

    def reset(self, rng: jax.Array) -> State:
        task = self.task or self.training_tasks().tasks[0]
        return self.start(rng, {name: jnp.float32(value) for name, value in task.params.items()})

    def step(self, state: State, action: jax.Array) -> State:
        motion = self.engine.step(*self.actuate(state.pipeline_state, action))
        outcome, seen = self.outcome(motion), self.observe(motion.after)
        return state.replace(
            pipeline_state=motion.after,
            obs=jnp.concatenate([state.obs[len(seen) :], seen]),
            reward=self.reward(outcome, state.info["task"]),
            done=jnp.asarray(self.terminated(motion.after), jnp.float32),
            metrics={**state.metrics, **outcome},
            info=_with_fresh_start(self, state.info),
        )

    @property
    def observation_size(self) -> int:
        """Numbers in what an agent is given: `history` observations, the oldest first."""
        return jax.eval_shape(lambda key: self._first_seen(self.initial(key)), jax.random.key(0)).shape[0]

    @property
    def action_size(self) -> int:
        return self.model.nu

    @property
    def backend(self) -> str:
        return self.engine.name

    def _first_seen(self, physics: Physics) -> jax.Array:
        return jnp.tile(self.observe(physics), self.history)

    def _still(self) -> tuple[jax.Array, Physics, jax.Array]:
        """The rest of a motion, for shapes only."""
        qpos, speed = jnp.zeros(self.model.nq), jnp.zeros(self.model.nv)
        return jnp.zeros(self.model.nu), Physics(qpos, speed, speed), jnp.zeros((len(self.bodies), 3))


def _with_fresh_start(family: Family, info: dict[str, Any]) -> dict[str, Any]:
    """Redraws the start that Brax's AutoResetWrapper keeps, which would otherwise replay one start for ever."""
    if "first_obs" not in info:
        return info
    key_first, key_later = jax.random.split(info["key"])
    first = family.initial(key_first)
    return {**info, "key": key_later, "first_pipeline_state": first, "first_obs": family._first_seen(first)}
