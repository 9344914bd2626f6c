"""Refuses a family that cannot be trained on, by shapes alone, before anything is compiled."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ear_jax.envs.family import Family
from ear_jax.errors import UsageError
from ear_jax.physics import Motion


def check_family(family: Family) -> None:
    """Raises UsageError, one line, with what the first fault is and what is expected."""
    name, tasks = family.name, family.training_tasks()
    for task in tasks.tasks:
        if task.params.keys() != tasks.tasks[0].params.keys():
            raise UsageError(
                f"{name}: tasks {tasks.names[0]!r} and {task.name!r} have different numbers in their params"
            )
        if not all(np.ndim(value) == 0 and np.isfinite(value) for value in task.params.values()):
            raise UsageError(f"{name}: the params of task {task.name!r} must be finite numbers, and are {task.params}")
    physics = _try(family, "initial", family.initial, jax.random.key(0))
    sizes = {"qpos": family.model.nq, "qvel": family.model.nv, "warmstart": family.model.nv}
    for field, size in sizes.items():
        _expect(name, f"initial().{field}", getattr(physics, field), (size,))
    obs = _try(family, "observe", family.observe, physics)
    if len(obs.shape) != 1:
        raise UsageError(f"{name}: observe() must be a vector, and has shape {obs.shape}")
    motion = Motion(physics, jnp.zeros(family.action_size), physics, jnp.zeros((len(family.bodies), 3)))
    outcome = _try(family, "outcome", family.outcome, motion)
    if not isinstance(outcome, dict) or not outcome:
        raise UsageError(f"{name}: outcome() must be a dictionary of named scalars")
    for key, value in outcome.items():
        _expect(name, f"outcome()[{key!r}]", value, ())
        if not np.isfinite(value):
            raise UsageError(f"{name}: outcome()[{key!r}] is {value} at a fresh start; it must be finite")
    params = jax.tree.map(lambda leaf: leaf[0], tasks.params)
    _expect(name, "reward()", _try(family, "reward", family.reward, outcome, params), ())
    _expect(name, "terminated()", _try(family, "terminated", family.terminated, physics), ())


def _try(family: Family, method: str, function: Any, *arguments: Any) -> Any:
    try:
        return function(*arguments)
    except Exception as error:
        raise UsageError(f"{family.name}: {method}() fails: {type(error).__name__}: {error}".splitlines()[0]) from error


def _expect(name: str, what: str, value: Any, shape: tuple[int, ...]) -> None:
    if jnp.shape(value) != shape:
        wanted = "a scalar" if shape == () else f"of shape {shape}"
        raise UsageError(f"{name}: {what} must be {wanted}, and has shape {jnp.shape(value)}")
