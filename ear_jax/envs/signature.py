"""Numbers that a family computes from made-up states, by which a change of its code is noticed.

No engine takes part, so they are the same on all; rounding, which differs between machines, is allowed for.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, TypeGuard

import jax
import jax.numpy as jnp
import numpy as np

from ear_jax.envs.family import Family
from ear_jax.physics import Motion, Physics
from ear_jax.physics.models import moving_numbers
from ear_jax.tasks import TaskSet

Signature = dict[str, list[float]]
STATES = 64  # made-up ones
# What a change shows in; the first of them names it.
ORDER = ("observe", "actuate", "terminated", "outcome", "achieved", "reward")
TOLERANCE = 1e-3  # relative


def signature_of(family: Family, tasks: TaskSet) -> Signature:
    """Returns what each part of a family computes, by its name: sums over states, without what is not finite.

    The model's numbers are summed too, with weights, so that their order counts.
    """
    rng = np.random.default_rng(0)
    start = jax.jit(family.initial)(jax.random.key(0))
    before, after = _moved(start, rng), _moved(start, rng)
    action = rng.uniform(-1, 1, (STATES, family.action_size)).astype(np.float32)
    positions = rng.normal(size=(STATES, len(family.bodies), 3)).astype(np.float32)

    def of_state(before: Physics, after: Physics, action: jax.Array, positions: jax.Array) -> dict[str, Any]:
        _, control = family.actuate(before, action)
        outcome, other = (
            family.outcome(Motion(one, control, two, positions)) for one, two in ((before, after), (after, before))
        )
        return {
            "observe": family.observe(before),
            "actuate": control,
            "terminated": family.terminated(before),
            "outcome": outcome,
            "achieved": family.achieved(outcome, other),
            "reward": jax.vmap(family.reward, in_axes=(None, 0))(outcome, tasks.params),
        }

    computed = jax.jit(jax.vmap(of_state))(before, after, action, positions)
    symmetry = family.symmetry
    signed = (symmetry.obs, symmetry.action) if symmetry else ()
    parts = {
        **{f"model.{name}": _weighted(numbers) for name, numbers in moving_numbers(family.model).items()},
        "substeps": family.substeps,
        "episode_length": family.episode_length,
        "bodies": [family.model.body(body).id for body in family.bodies],
        "symmetry": [_weighted((one.order + 1) * one.sign) for one in signed],
        "initial": start,
        **{name: jax.tree.map(_sum, computed[name]) for name in ORDER},
    }
    return {name: _flat(part) for name, part in parts.items()}


def first_change(before: Signature, now: Signature) -> str | None:
    """Returns the name of the first part that computes other numbers now; None if all that both have are the same."""
    return next((name for name in now if name in before and not _alike(before[name], now[name])), None)


def is_signature(value: Any) -> TypeGuard[Signature]:
    """Returns whether a value, as of a file, has the form of a signature."""
    return isinstance(value, dict) and all(
        isinstance(numbers, list) and all(isinstance(number, (int, float)) for number in numbers)
        for numbers in value.values()
    )


def _moved(state: Physics, rng: np.random.Generator) -> Physics:
    """Returns states [STATES] ever further from a start, and at velocities, which a start often lacks."""
    size = np.geomspace(0.02, 3, STATES)[:, None]
    many = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (STATES, *leaf.shape)), state)
    qpos = state.qpos + size * rng.normal(size=many.qpos.shape)
    return replace(many, qpos=jnp.float32(qpos), qvel=jnp.float32(3 * size * rng.normal(size=many.qvel.shape)))


def _weighted(numbers: np.ndarray) -> float:
    flat = np.nan_to_num(np.asarray(numbers, float).ravel(), posinf=0.0, neginf=0.0)
    return float(flat @ (1 + np.arange(flat.size) % 97 / 97))


def _sum(values: jax.Array) -> np.ndarray:
    """Sums values [STATES, …] over the states where they are finite."""
    return np.nan_to_num(np.asarray(values, float), posinf=0.0, neginf=0.0).sum(axis=0)


def _flat(part: Any) -> list[float]:
    numbers = [np.asarray(leaf, float).ravel() for leaf in jax.tree.leaves(part)]
    return [float(f"{number:.6g}") for number in np.concatenate([*numbers, np.zeros(0)])]


def _alike(one: list[float], other: list[float]) -> bool:
    return len(one) == len(other) and np.allclose(one, other, rtol=TOLERANCE, atol=1e-5)
