"""Numbers that a family computes from made-up states, by which a change of its code is noticed.

No engine takes part, so they are the same on all; rounding, which differs between machines, is allowed for.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ear_jax.envs.family import Family
from ear_jax.physics import Motion, Physics
from ear_jax.tasks import TaskSet

Signature = dict[str, list[float]]
OF_MODEL = (
    *("qpos0", "body_mass", "body_inertia", "geom_size", "geom_friction", "dof_damping", "dof_armature"),
    *("jnt_range", "jnt_stiffness", "actuator_gear", "actuator_ctrlrange"),
)
STATES = 64  # made-up ones
TOLERANCE = 1e-3  # relative


def signature_of(family: Family, tasks: TaskSet) -> Signature:
    """Returns what each part of a family computes, by its name: sums over states, without what is not finite."""
    rng, model = np.random.default_rng(0), family.model
    start = jax.jit(family.initial)(jax.random.key(0))
    before, after = _moved(start, rng), _moved(start, rng)
    action = rng.uniform(-1, 1, (STATES, family.action_size)).astype(np.float32)
    positions = rng.normal(size=(STATES, len(family.bodies), 3)).astype(np.float32)

    def of_state(before: Physics, after: Physics, action: jax.Array, positions: jax.Array) -> dict[str, Any]:
        _, control = family.actuate(before, action)
        outcome = family.outcome(Motion(before, control, after, positions))
        return {
            "observe": family.observe(before),
            "actuate": control,
            "terminated": family.terminated(before),
            "outcome": outcome,
            "reward": jax.vmap(family.reward, in_axes=(None, 0))(outcome, tasks.params),
        }

    parts = {
        "load": [np.sum(getattr(model, name)) for name in OF_MODEL] + [model.opt.timestep, family.substeps],
        "episode_length": family.episode_length,
        "initial": start,
        **jax.tree.map(_sum, jax.jit(jax.vmap(of_state))(before, after, action, positions)),
    }
    return {name: _flat(part) for name, part in parts.items()}


def first_change(before: Signature, now: Signature) -> str | None:
    """Returns the name of the first part that computes other numbers now; None if all compute the same."""
    return next((name for name in now if not _alike(before.get(name, []), now[name])), None)


def _moved(state: Physics, rng: np.random.Generator) -> Physics:
    """Returns states [STATES] ever further from a start, and at velocities, which a start often lacks."""
    size = np.geomspace(0.02, 3, STATES)[:, None]
    many = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (STATES, *leaf.shape)), state)
    qpos = state.qpos + size * rng.normal(size=many.qpos.shape)
    return replace(many, qpos=jnp.float32(qpos), qvel=jnp.float32(3 * size * rng.normal(size=many.qvel.shape)))


def _sum(values: jax.Array) -> np.ndarray:
    """Sums values [STATES, …] over the states where they are finite."""
    return np.nan_to_num(np.asarray(values, float), posinf=0.0, neginf=0.0).sum(axis=0)


def _flat(part: Any) -> list[float]:
    numbers = [np.asarray(leaf, float).ravel() for leaf in jax.tree.leaves(part)]
    return [float(f"{number:.6g}") for number in np.concatenate([*numbers, np.zeros(0)])]


def _alike(one: list[float], other: list[float]) -> bool:
    return len(one) == len(other) and np.allclose(one, other, rtol=TOLERANCE, atol=1e-5)
