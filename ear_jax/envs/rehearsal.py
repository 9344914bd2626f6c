"""Rehearsals of a user's family: its methods called twice, and some steps under random actions."""

from __future__ import annotations

import copy
import functools
import re
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from ear_jax.envs.family import Family
from ear_jax.errors import UsageError, counted
from ear_jax.physics import Motion, Physics
from ear_jax.process.terminal import say
from ear_jax.tasks import TaskSet

STEPS = 20  # environment steps
Call = Callable[..., Any]  # a method of the family whose exceptions are one line


def check_pure(family: Family, calls: dict[str, tuple[Call, tuple[Any, ...]]]) -> None:
    """Raises UsageError for a method that gives something else when it is called again.

    JAX traces a method once, so a random number of NumPy or a clock would keep the value of that moment.

    Args:
      family: the family.
      calls: its traced methods with arguments, by name.
    """
    for name, (method, arguments) in calls.items():
        first, second = (jax.make_jaxpr(_anew(method))(*arguments) for _ in range(2))
        constants = zip(first.consts, second.consts, strict=False)
        if _text(first) != _text(second) or not all(np.array_equal(*pair, equal_nan=True) for pair in constants):
            raise UsageError(
                f"{name}() gives something else when it is called again, but JAX calls it only once and keeps that; "
                "draw random numbers by jax.random from the key of initial(), and use no other, no clock and no counter"
            )
    for name in ("training_tasks", "adaptation_tasks"):
        arguments = (0,) if name == "adaptation_tasks" else ()
        tasks: list[TaskSet] = [getattr(family, name)(*arguments) for _ in range(2)]
        if tasks[0].fingerprint != tasks[1].fingerprint:
            raise UsageError(f"{name}() gives other tasks when it is called again; draw them from a fixed seed")
    if (different := _difference(family.model, family.load())) is not None:
        raise UsageError(f"load() gives another model when it is called again: {different} differs; fix its numbers")


def check_steps(family: Family, start: Physics, tasks: TaskSet, calls: dict[str, Call], expect: Call) -> None:
    """Raises UsageError for a number of the family that is not finite after some steps under random actions.

    The steps are those of plain MuJoCo, and end if the robot fails or the simulation diverges.

    Args:
      family: the family.
      start: the state to start from.
      tasks: the tasks whose rewards are computed.
      calls: traced methods by name.
      expect: (name, value, moment) raises UsageError unless the value is finite.
    """
    model, rng, now = copy.copy(family.model), np.random.default_rng(0), start
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    data = mujoco.MjData(model)
    for step in range(1, STEPS + 1):
        action = jnp.asarray(rng.uniform(-1, 1, family.action_size), jnp.float32)
        motion = _step(family, data, *calls["actuate"](now, action))
        now, moment = motion.after, f"after {counted(step, 'step')} of random actions"
        if not all(np.all(np.abs(leaf) < mujoco.mjMAXVAL) for leaf in jax.tree.leaves(now)):
            return
        expect("observe()", calls["observe"](now), moment)
        outcome = calls["outcome"](motion)
        for name, value in outcome.items():
            expect(f"outcome()[{name!r}]", value, moment)
        for task in tasks.tasks:
            expect(f"reward() of task {task.name!r}", calls["reward"](outcome, task.params), moment)
        if calls["terminated"](now):
            return


def warn_of_ranges(family: Family) -> None:
    """Says in one line that controls have other ranges than actions, unless the family converts actions itself."""
    model = family.model
    if type(family).actuate is not Family.actuate:
        return
    odd = [i for i in range(model.nu) if model.actuator_ctrllimited[i] and list(model.actuator_ctrlrange[i]) != [-1, 1]]
    if odd:
        low, high = model.actuator_ctrlrange[odd[0]]
        others = f" and {len(odd) - 1} more" if len(odd) > 1 else ""
        _say_once(
            f"warning: {family.name}: actuator {model.actuator(odd[0]).name or odd[0]!r}{others} takes controls from "
            f"{low:g} to {high:g}, but actions are from -1 to 1 and become controls unchanged; scale them in actuate()"
        )


@functools.cache
def _say_once(line: str) -> None:
    say(line)


def _anew(method: Call) -> Call:
    """Wraps a method so that JAX traces it again."""
    return lambda *arguments: method(*arguments)


def _text(jaxpr: Any) -> str:
    """Returns a traced program as text, without the addresses of Python objects."""
    return re.sub(r"0x[0-9a-f]+", "", str(jaxpr.jaxpr))


def _difference(one: mujoco.MjModel, other: mujoco.MjModel) -> str | None:
    """Returns the name of the first field of numbers that two models differ in."""
    for holder in ("", "opt"):
        first, second = (getattr(model, holder) if holder else model for model in (one, other))
        for name in dir(first):
            value = getattr(first, name) if not name.startswith("_") else None
            if isinstance(value, np.ndarray | int | float) and not np.array_equal(value, getattr(second, name)):
                return name
    return None


def _step(family: Family, data: mujoco.MjData, before: Physics, control: jax.Array) -> Motion:
    model = data.model
    fields = {"qpos": "qpos", "qvel": "qvel", "warmstart": "qacc_warmstart", "mocap": "mocap_pos", "act": "act"}
    held = {ours: theirs for ours, theirs in fields.items() if getattr(before, ours) is not None}
    for ours, theirs in held.items():
        getattr(data, theirs)[:] = getattr(before, ours)
    data.ctrl[:] = control
    mujoco.mj_step(model, data, family.substeps)
    after = Physics(**{ours: jnp.asarray(getattr(data, theirs), jnp.float32) for ours, theirs in held.items()})
    mujoco.mj_kinematics(model, data)
    positions = np.array([data.body(body).xpos for body in family.bodies], np.float32).reshape(-1, 3)
    return Motion(before, control, after, jnp.asarray(positions))
