"""Checks of a family before training is compiled; each fault is one line."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from ear_jax.envs.family import Family
from ear_jax.envs.rehearsal import check_pure, check_steps, warn_of_ranges
from ear_jax.envs.symmetry import Symmetry
from ear_jax.envs.user_code import source_file, user_code
from ear_jax.errors import UsageError, unknown
from ear_jax.physics import Motion, Physics
from ear_jax.tasks import Task, TaskSet, task_set

# Names used beside outcomes: by evaluations, by Brax's wrappers, and by trajectories.
RESERVED = ("return", "length", "reward", "sum_reward", "qpos", "code")


def check_class(kind: Any, name: str) -> None:
    """Raises UsageError for a value that is not a family class, or for one that lacks a method or attribute."""
    if not (isinstance(kind, type) and issubclass(kind, Family)):
        raise UsageError(f"{name} is not a family: it must be a class derived from ear_jax.envs.Family")
    if kind.__abstractmethods__:
        methods = ", ".join(f"{method}()" for method in sorted(kind.__abstractmethods__))
        raise UsageError(f"{name} does not define {methods}")
    default_load = kind.load is Family.load
    for attribute, (is_valid, wanted) in ({**_ATTRIBUTES, **_MODEL} if default_load else _ATTRIBUTES).items():
        if not hasattr(kind, attribute):
            raise UsageError(f"{name} does not define {attribute}; it must be {wanted}")
        if not is_valid(getattr(kind, attribute)):
            raise UsageError(f"{name}: {attribute} must be {wanted}, but is {getattr(kind, attribute)!r}")


def check_family(family: Family) -> None:
    """Raises UsageError for a family's first fault, with what is expected instead; warns of odd ranges of controls."""
    tasks = _check_task_sets(family)
    if not family.action_size:
        raise UsageError("the model has no actuators" if not family.model.nu else "action_size is 0")
    _check_looks(family, tasks)
    call = {name: _traced(family, name) for name in ("observe", "terminated", "actuate", "outcome", "reward")}
    key, action = jax.random.key(0), jnp.zeros(family.action_size)
    physics = _traced(family, "initial")(key)
    _check_start(family, physics)
    _expect("observe()", call["observe"](physics), None, "float32")
    _expect("terminated()", call["terminated"](physics), (), "bool")
    moved, control = _check_actuated(family, call["actuate"](physics, action))
    motion = Motion(moved, control, physics, jnp.zeros((len(family.bodies), 3)))
    outcome = call["outcome"](motion)
    _check_outcome(family, outcome)
    _check_names(family, tasks, outcome)
    for task in tasks.tasks:
        _expect(f"reward() of task {task.name!r}", call["reward"](outcome, task.params), (), "float32")
    _expect("achieved()", _traced(family, "achieved")(outcome, outcome), ())
    arguments = {"initial": (key,), "observe": (physics,), "terminated": (physics,), "actuate": (physics, action)}
    arguments |= {"outcome": (motion,), "reward": (outcome, tasks.tasks[0].params), "achieved": (outcome, outcome)}
    check_pure(family, {name: (_guarded(family, name), values) for name, values in arguments.items()})
    check_steps(family, physics, tasks, call, _expect_finite)
    warn_of_ranges(family)


def check_task(task: Any, like: Any, source: str) -> None:
    """Raises UsageError for a task from `source` that is faulty or cannot share a task set with `like`."""
    if not isinstance(task, Task):
        raise UsageError(f"{source}: a task must be a Task, but is {_kind(task)}")
    if not (_is_text(task.name) and (task.target is None or _is_number(task.target))):
        wanted = f"a name and a target, a number below {mujoco.mjMAXVAL:g} or None"
        raise UsageError(f"{source}: a task needs {wanted}, but one is {task}")
    if not (isinstance(task.params, dict) and task.params and all(map(_is_number, task.params.values()))):
        wanted = f"the params of task {task.name!r} must be numbers below {mujoco.mjMAXVAL:g} by name"
        raise UsageError(f"{source}: {wanted}, but are {task.params}")
    if task.params.keys() != like.params.keys():
        raise UsageError(f"{source}: tasks {like.name!r} and {task.name!r} have different numbers in their params")


def _check_task_sets(family: Family) -> TaskSet:
    """Checks both task sets and returns the training tasks."""
    task_sets = {
        "training_tasks": _guarded(family, "training_tasks")(),
        "adaptation_tasks": _guarded(family, "adaptation_tasks")(0),
    }
    for method, tasks in task_sets.items():
        if not isinstance(tasks, TaskSet):
            raise UsageError(f"{method}() must return a task_set(…), but returns {_kind(tasks)}")
    training = task_set(task_sets["training_tasks"].tasks)
    for method, tasks in task_sets.items():
        for task in tasks.tasks:
            check_task(task, training.tasks[0], f"{method}()")
    return training


def _check_looks(family: Family, tasks: TaskSet) -> None:
    """Checks what is read outside training: options, symmetry, pictures, and what tasks ask for."""
    for option in family.options:
        if not hasattr(family, option):
            raise UsageError(f"options names {option!r}, which has no default; define it in the class")
    symmetry = user_code("symmetry fails", source_file(type(family)))(lambda: family.symmetry)()
    if not isinstance(symmetry, Symmetry | None):
        raise UsageError(f"symmetry must be a Symmetry or None, but is {_kind(symmetry)}")
    if not isinstance(portrait := _guarded(family, "portrait")(), mujoco.MjModel):
        raise UsageError(f"portrait() must return a mujoco.MjModel, but returns {_kind(portrait)}")
    for task in tasks.tasks:
        asked, goal = _guarded(family, "asks")(task), _guarded(family, "goal")(task)
        if not (_are_texts(asked) and len(asked) == 2):
            raise UsageError(f"asks() must return the name of an outcome and its unit, but returns {asked!r}")
        if goal is not None and not (np.shape(goal) == (3,) and all(map(_is_number, goal))):
            raise UsageError(f"goal() must return three coordinates or None, but returns {goal!r}")


def _check_start(family: Family, physics: Any) -> None:
    if not isinstance(physics, Physics):
        raise UsageError(f"initial() must return a Physics, but returns {_kind(physics)}")
    model = family.model
    shapes: dict[str, tuple[int, ...]] = {"qpos": (model.nq,), "qvel": (model.nv,), "warmstart": (model.nv,)}
    shapes |= {"mocap": (model.nmocap, 3)} if model.nmocap else {}
    shapes |= {"act": (model.na,)} if model.na else {}
    for field, shape in shapes.items():
        _expect(f"initial().{field}", getattr(physics, field), shape, "float32")


def _check_actuated(family: Family, result: Any) -> tuple[Physics, jax.Array]:
    """Checks and returns what `actuate` returns for an action of zeros."""
    if not (isinstance(result, tuple) and len(result) == 2 and isinstance(result[0], Physics)):
        raise UsageError(f"actuate() must return a Physics and a control, but returns {_kind(result)}")
    _expect("the control that actuate() returns", result[1], (family.model.nu,), "float32")
    return result


def _check_outcome(family: Family, outcome: Any) -> None:
    if not isinstance(outcome, dict) or not outcome:
        raise UsageError(f"outcome() must return a dictionary of named scalars, but returns {_kind(outcome)}")
    for name, value in outcome.items():
        if name in RESERVED:
            raise UsageError(f"outcome() must not contain {name!r}, which is reserved; rename it")
        _expect(f"outcome()[{name!r}]", value, ())
    if type(family).achieved is Family.achieved and family.commanded not in outcome:
        raise UsageError(f"commanded: {unknown('outcome', family.commanded, outcome)}")


def _check_names(family: Family, tasks: TaskSet, outcome: Mapping[str, Any]) -> None:
    """Checks what the family says of its outcomes and bodies outside training."""
    for name in family.plane or ():
        if name not in outcome:
            raise UsageError(f"plane: {unknown('outcome', name, outcome)}")
    bodies = [family.model.body(body).name for body in range(family.model.nbody)]
    for body in family.feet.values():
        if body not in bodies:
            raise UsageError(f"feet: {unknown('body', body, bodies)}")
    asked = {family.asks(task)[0] for task in tasks.tasks} - {family.commanded}
    for name in asked:
        if name not in outcome:
            raise UsageError(f"asks(): {unknown('outcome', name, outcome)}")
    apart = _guarded(family, "difference")(1.0, 0.5)
    if np.ndim(apart) or not np.issubdtype(np.asarray(apart).dtype, np.number):
        raise UsageError(f"difference() must return a number, but returns {apart!r}")


def _guarded(family: Family, method: str, wrap: Callable[..., Any] = lambda function: function) -> Callable[..., Any]:
    """Wraps a family's method so that an exception in it becomes a UsageError."""
    return user_code(f"{method}() fails", source_file(type(family)))(wrap(getattr(family, method)))


def _traced(family: Family, method: str) -> Callable[..., Any]:
    """Does the same, and traces the method as training does."""
    return _guarded(family, method, jax.jit)


def _expect(name: str, value: Any, shape: tuple[int, ...] | None, dtype: str | None = None) -> None:
    """Raises UsageError unless a value of a fresh start is finite, of that shape (None: a vector) and that dtype."""
    wanted = "a vector" if shape is None else f"of shape {shape}" if shape else "a scalar"
    if not isinstance(value, jax.Array):
        raise UsageError(f"{name} must be {wanted}, but is {_kind(value)}")
    if (value.ndim != 1 or not value.size) if shape is None else (value.shape != shape):
        raise UsageError(f"{name} must be {wanted}, but has shape {value.shape}")
    if dtype not in (None, value.dtype.name):
        raise UsageError(f"{name} must be {dtype}, but is {value.dtype}")
    _expect_finite(name, value, "at a fresh start")


def _expect_finite(name: str, value: jax.Array, moment: str) -> None:
    for index, number in np.ndenumerate(value):
        if not np.isfinite(number):
            raise UsageError(f"{name}{list(index) or ''} is {number} {moment}; it must be finite")


def _kind(value: Any) -> str:
    return "None" if value is None else f"a value of type {type(value).__name__}"


def _is_number(value: Any) -> bool:
    """Returns True for a Python number below MuJoCo's own limit, past which a step counts as not finite."""
    return isinstance(value, (int, float)) and abs(value) < mujoco.mjMAXVAL


def _is_count(value: Any) -> bool:
    return isinstance(value, int) and value >= 1


def _is_text(value: Any) -> bool:
    return isinstance(value, str) and value != "" and value.isprintable()


def _are_texts(value: Any) -> bool:
    return isinstance(value, tuple) and all(map(_is_text, value))


def _are_presets(value: Any) -> bool:
    return isinstance(value, Mapping) and all(isinstance(changes, Mapping) for changes in value.values())


def _are_feet(value: Any) -> bool:
    return isinstance(value, Mapping) and all(_is_text(text) for pair in value.items() for text in pair)


def _is_period(value: Any) -> bool:
    return value is None or (_is_number(value) and not isinstance(value, bool) and value > 0)


def _is_plane(value: Any) -> bool:
    return value is None or (_are_texts(value) and len(value) == 2)


def _are_limits(value: Any) -> bool:
    return isinstance(value, tuple) and len(value) == 2 and all(map(_is_count, value))


_ATTRIBUTES = {
    "name": (_is_text, "a non-empty string of printable characters"),
    "substeps": (_is_count, "a whole number of at least 1"),
    "mjx_solver": (_are_limits, "two whole numbers of at least 1, as in (4, 8)"),
    "commanded": (_is_text, "the name of an outcome"),
    "unit": (_is_text, "a non-empty string of printable characters"),
    "bodies": (_are_texts, "a tuple of names"),
    "episode_length": (_is_count, "a whole number of at least 1"),
    "options": (_are_texts, "a tuple of names"),
    "feet": (_are_feet, "a dictionary of bodies by the names of feet"),
    "period": (_is_period, "a number above 0, or None"),
    "plane": (_is_plane, "two names of outcomes, or None"),
    "presets": (_are_presets, "a dictionary of settings for each preset"),
}
_MODEL = {"model_file": (_is_text, "one of Gymnasium's models, unless load() is defined")}
