"""Where bodies are, from generalised positions alone; the same on every engine."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from ear_jax.process.silent_imports import mjx

_product = partial(jnp.matmul, precision="highest")  # where the default rounds to 10 bits, as on a GPU


def body_positions(model: mujoco.MjModel, body_ids: list[int]) -> Callable[[jax.Array], jax.Array]:
    """Maps qpos [nq] to the positions [bodies, 3] of the given bodies, metres, by MJX's kinematics.

    Engines do not tell them: after `mj_step` MuJoCo's positions lag one substep behind its state, and refreshing them
    there (all of `mj_fwdPosition`, collisions too) costs the native engine a tenth of its speed.
    """
    if not body_ids:
        return lambda qpos: jnp.zeros((0, 3))
    on_device, blank = mjx.put_model(model, impl="jax"), mjx.make_data(model, impl="jax")
    rows = jnp.asarray(body_ids, jnp.int32)
    return lambda qpos: mjx.kinematics(on_device, blank.replace(qpos=qpos)).xpos[rows]


def body_points(model: mujoco.MjModel, points: Sequence[tuple[str, np.ndarray]]) -> Callable[[jax.Array], jax.Array]:
    """Maps qpos [nq] to where points of bodies are, [points, 3] metres; each is a body and a place [3] on it.

    The bodies hang from hinges and slides. MJX's kinematics tell it too, but XLA's CPU compiler fuses a chain of links
    and computes each anew for all that come after: for an arm of seven joints a call took seconds. A matmul a link
    keeps them apart.
    """
    needed: set[int] = set()
    for name, _ in points:
        body = model.body(name).id
        while body:
            needed.add(body)
            body = int(model.body_parentid[body])

    def positions(qpos: jax.Array) -> jax.Array:
        frames = {0: (jnp.zeros(3), jnp.eye(3))}
        for body in sorted(needed):  # a parent's number is less than its children's
            frames[body] = _hang(model, body, *frames[int(model.body_parentid[body])], qpos)
        at = [(*frames[model.body(name).id], place) for name, place in points]
        return jnp.stack([origin + _product(rotation, place) for origin, rotation, place in at])

    return positions


def _hang(
    model: mujoco.MjModel, body: int, origin: jax.Array, rotation: jax.Array, qpos: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Where a body is and how it is turned, from the same of its parent; it has at most one joint, at its origin."""
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, model.body_quat[body])
    origin, rotation = origin + _product(rotation, model.body_pos[body]), _product(rotation, turn.reshape(3, 3))
    if not model.body_jntnum[body]:
        return origin, rotation
    joint = model.body_jntadr[body]
    axis, moved = model.jnt_axis[joint], qpos[model.jnt_qposadr[joint]]
    if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE:
        return origin + _product(rotation, axis) * moved, rotation
    return origin, _product(rotation, _about(axis, moved))


def _about(axis: np.ndarray, angle: jax.Array) -> jax.Array:
    """The rotation [3, 3] about a unit vector (Rodrigues)."""
    x, y, z = axis
    across = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return jnp.eye(3) + jnp.sin(angle) * across + (1 - jnp.cos(angle)) * (across @ across)
