"""The base class of task families: one robot and its physics, with a reward per task."""

from __future__ import annotations

import abc
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import mujoco

from ear_jax.envs.environment import Env, State
from ear_jax.envs.symmetry import Symmetry
from ear_jax.errors import UsageError
from ear_jax.physics import Motion, Physics, make_engine
from ear_jax.physics.models import gymnasium_model_path, load_model
from ear_jax.tasks import Task, TaskParams, TaskSet

Outcome = dict[str, jax.Array]


class Family(Env):
    """A Brax environment of one robot whose tasks share physics and differ in reward.

    All methods are written for one environment. A step yields an `outcome`, a few named scalars. A task is a pytree of
    numbers that `reward` reads to score an outcome, so one roll-out can be scored for any task. A subclass defines the
    model and the abstract methods, and never branches on a task.

    As a Brax environment, `State.pipeline_state` is a `Physics`, `State.metrics` the outcome, `State.info["task"]` the
    task's numbers and `State.info["key"]` the random key of later resets. `reset` starts `task`, by default the first
    training task.
    """

    name: ClassVar[str]
    model_file: ClassVar[str]  # one of Gymnasium's models
    substeps: ClassVar[int]  # MuJoCo steps in one environment step
    mjx_solver: ClassVar[tuple[int, int]]  # limits on MJX's solver and line-search iterations, measured
    bodies: tuple[str, ...] = ()  # bodies whose positions `outcome` reads
    feet: ClassVar[dict[str, str]] = {}  # display name → body that touches the ground
    commanded: ClassVar[str]  # name of the outcome that a task's target is for
    unit: ClassVar[str]  # of the target and of the commanded outcome
    period: ClassVar[float | None] = None  # value at which the commanded outcome wraps, such as 360 degrees
    plane: ClassVar[tuple[str, str] | None] = None  # outcomes that are its velocity on the floor in m/s, x and y
    episode_length: ClassVar[int] = 200  # steps; the time limit is not a termination

    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {}  # preset → settings changed for this family

    history: int = 1  # observations the agent sees at once; at a start all are the first observation

    options: ClassVar[tuple[str, ...]] = ()  # attributes that the constructor may set

    def __init__(self, engine: str = "auto", task: Task | None = None, **options: Any):
        for option, value in options.items():
            setattr(self, option, value)
        self.model = self.load()
        if not isinstance(self.model, mujoco.MjModel):
            raise UsageError(f"load() must return a mujoco.MjModel, not a {type(self.model).__name__}")
        self.engine = make_engine(engine, self.model, self.substeps, self.bodies, self.mjx_solver)
        self.task = task
        self.dt = float(self.model.opt.timestep) * self.substeps  # seconds in one environment step

    # Defined by a family.

    def load(self) -> mujoco.MjModel:
        """Returns the model; by default Gymnasium's `model_file`."""
        return load_model(self.model_file)

    def source(self) -> str:
        """Returns the model as MJCF, for MuJoCo outside Python; by default Gymnasium's `model_file`."""
        return gymnasium_model_path(self.model_file).read_text(encoding="utf-8")

    @property
    def symmetry(self) -> Symmetry | None:
        """The robot's rotations and mirror images; None by default."""
        return None

    def portrait(self) -> mujoco.MjModel:
        """Returns the model that pictures show, with the same qpos; by default the model itself."""
        return self.model

    @abc.abstractmethod
    def training_tasks(self) -> TaskSet:
        """Returns the training tasks, in the order of their one-hots."""

    def spread_tasks(self, count: int) -> TaskSet:
        """Returns `count` training tasks spread evenly over its range; by default a family has none.

        Raises:
          UsageError: the family has no range.
        """
        raise UsageError(f"{self.name} has no range to spread {count} tasks over; name them with --tasks")

    def adaptation_tasks(self, seed: int) -> TaskSet:
        """Returns tasks not trained on, drawn from a seed; none by default."""
        return TaskSet(())

    @abc.abstractmethod
    def parse_task(self, text: str) -> Task:
        """Returns the task that a user's text names; raises UsageError if there is none."""

    @abc.abstractmethod
    def initial(self, key: jax.Array) -> Physics:
        """Draws a random initial state."""

    def actuate(self, physics: Physics, action: jax.Array) -> tuple[Physics, jax.Array]:
        """Returns the state to step from and the control [nu] held for the step; by default the action."""
        return physics, action

    @abc.abstractmethod
    def observe(self, physics: Physics) -> jax.Array:
        """Returns the observation of a state, [size]."""

    @abc.abstractmethod
    def outcome(self, motion: Motion) -> Outcome:
        """Returns a step's outcome, the named scalars from which any task of the family is scored."""

    @abc.abstractmethod
    def reward(self, outcome: Outcome, task: TaskParams) -> jax.Array:
        """Returns an outcome's reward for one task, a scalar."""

    def terminated(self, physics: Physics) -> jax.Array:
        """Returns whether the robot has failed, a scalar bool; by default it never does."""
        return jnp.zeros((), bool)

    def achieved(self, late: Outcome, whole: Outcome) -> jax.Array:
        """Returns the commanded quantity, from outcomes averaged over an episode's second half and over all of it."""
        return late[self.commanded]

    def difference(self, one: Any, other: Any) -> Any:
        """Returns `one` − `other` in the commanded quantity, within ± half a period if it wraps."""
        if self.period is None:
            return one - other
        return (one - other + self.period / 2) % self.period - self.period / 2

    def asks(self, task: Task) -> tuple[str, str]:
        """Returns the outcome that a task asks for, and its unit; by default the commanded one."""
        return self.commanded, self.unit

    def goal(self, task: Task) -> tuple[float, float, float] | None:
        """Returns the point that a task asks the robot to reach, metres; None by default."""
        return None

    # Derived from those definitions.

    @property
    def quantity(self) -> dict[str, str]:
        """The commanded quantity and its unit, for JSON documents."""
        return {"outcome": self.commanded, "unit": self.unit}

    def noisy_start(self, key: jax.Array, position: float, speed: Callable[..., jax.Array]) -> Physics:
        """Draws a start: the model's default pose plus U(±position) per coordinate, speeds by `speed(key, shape)`."""
        key_qpos, key_qvel = jax.random.split(key)
        noise = jax.random.uniform(key_qpos, (self.model.nq,), minval=-position, maxval=position)
        qpos0 = jnp.asarray(self.model.qpos0, jnp.float32)
        act = {"act": jnp.zeros(self.model.na)} if self.model.na else {}
        return Physics(qpos0 + noise, speed(key_qvel, (self.model.nv,)), jnp.zeros(self.model.nv), **act)

    def start(self, key: jax.Array, task: TaskParams) -> State:
        """Starts an episode of one task at a random state."""
        key_initial, key_later = jax.random.split(key)
        physics = self.initial(key_initial)
        outcome = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), self._outcome_shapes(physics))
        info: dict[str, Any] = {"task": task, "key": key_later}
        return State(physics, self._first_obs(physics), jnp.zeros(()), jnp.zeros(()), outcome, info)

    def reset(self, rng: jax.Array) -> State:
        task = self.task or self.training_tasks().tasks[0]
        return self.start(rng, {name: jnp.float32(value) for name, value in task.params.items()})

    def step(self, state: State, action: jax.Array) -> State:
        motion = self.engine.step(*self.actuate(state.pipeline_state, action))
        outcome, obs = self.outcome(motion), self.observe(motion.after)
        return replace(
            state,
            pipeline_state=motion.after,
            obs=jnp.concatenate([state.obs[len(obs) :], obs]),
            reward=self.reward(outcome, state.info["task"]),
            done=jnp.asarray(self.terminated(motion.after), jnp.float32),
            metrics={**state.metrics, **outcome},
            info=_with_fresh_start(self, state.info),
        )

    @property
    def observation_size(self) -> int:
        """Size of the agent's input: `history` observations, the oldest first."""
        return int(jax.eval_shape(lambda key: self._first_obs(self.initial(key)), jax.random.key(0)).size)

    @property
    def outcome_shapes(self) -> Outcome:
        """A step's outcome as shapes by name; nothing is computed."""
        return self._outcome_shapes(jax.eval_shape(self.initial, jax.random.key(0)))

    @property
    def action_size(self) -> int:
        return int(self.model.nu)

    @property
    def backend(self) -> str:
        return self.engine.name

    def _outcome_shapes(self, physics: Physics) -> Outcome:
        no_motion = (physics, jnp.zeros(self.model.nu), physics, jnp.zeros((len(self.bodies), 3)))
        shapes: Outcome = jax.eval_shape(self.outcome, Motion(*no_motion))
        return shapes

    def _first_obs(self, physics: Physics) -> jax.Array:
        return jnp.tile(self.observe(physics), self.history)


def _with_fresh_start(family: Family, info: dict[str, Any]) -> dict[str, Any]:
    """Redraws the start that Brax's AutoResetWrapper stores; without this every reset would be the same."""
    if "first_obs" not in info:
        return info
    key_first, key_later = jax.random.split(info["key"])
    first = family.initial(key_first)
    return {**info, "key": key_later, "first_pipeline_state": first, "first_obs": family._first_obs(first)}
