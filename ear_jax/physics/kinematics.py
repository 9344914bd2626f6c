"""Positions of bodies, computed from generalised positions alone and so the same on every engine."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

_matmul = partial(jnp.matmul, precision="highest")  # a GPU's default rounds mantissas to 10 bits


def body_positions(model: mujoco.MjModel, body_ids: list[int]) -> Callable[[jax.Array], jax.Array]:
    """Maps qpos [nq] to the positions [bodies, 3] of the given bodies, metres, by MJX's kinematics.

    The engines' own positions cannot be used: after `mj_step` they lag one substep behind the state. Refreshing them
    (all of `mj_fwdPosition`, collisions included) would cost the native engine a tenth of its speed.
    """
    if not body_ids:
        return lambda qpos: jnp.zeros((0, 3))
    from ear_jax.process.silent_imports import mjx

    on_device, blank = mjx.put_model(model, impl="jax"), mjx.make_data(model, impl="jax")
    rows = jnp.asarray(body_ids, jnp.int32)
    return lambda qpos: mjx.kinematics(on_device, blank.replace(qpos=qpos)).xpos[rows]


def body_points(model: mujoco.MjModel, points: Sequence[tuple[str, np.ndarray]]) -> Callable[[jax.Array], jax.Array]:
    """Maps qpos [nq] to the positions [points, 3] of points on bodies, metres; a point is a body and an offset [3].

    All joints must be hinges or slides. MJX's kinematics are not used here: XLA's CPU compiler fuses the chain of links
    and recomputes each link for every later one, so a call took seconds for an arm of seven joints. One matmul per link
    prevents that fusion.
    """
    chain: set[int] = set()
    for name, _ in points:
        body = model.body(name).id
        while body:
            chain.add(body)
            body = int(model.body_parentid[body])

    def positions(qpos: jax.Array) -> jax.Array:
        frames = {0: (jnp.zeros(3), jnp.eye(3))}
        for body in sorted(chain):  # a parent's id is below its children's
            frames[body] = _body_frame(model, body, *frames[int(model.body_parentid[body])], qpos)
        located = [(*frames[model.body(name).id], offset) for name, offset in points]
        return jnp.stack([origin + _matmul(rotation, offset) for origin, rotation, offset in located])

    return positions


def _body_frame(
    model: mujoco.MjModel, body: int, origin: jax.Array, rotation: jax.Array, qpos: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Returns a body's origin and rotation from its parent's; the body has at most one joint, at its origin."""
    relative = np.zeros(9)
    mujoco.mju_quat2Mat(relative, model.body_quat[body])
    origin, rotation = origin + _matmul(rotation, model.body_pos[body]), _matmul(rotation, relative.reshape(3, 3))
    if not model.body_jntnum[body]:
        return origin, rotation
    joint = model.body_jntadr[body]
    axis, value = model.jnt_axis[joint], qpos[model.jnt_qposadr[joint]]
    if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE:
        return origin + _matmul(rotation, axis) * value, rotation
    return origin, _matmul(rotation, _rotation(axis, value))


def _rotation(axis: np.ndarray, angle: jax.Array) -> jax.Array:
    """Returns the rotation [3, 3] about a unit vector (Rodrigues' formula)."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return jnp.eye(3) + jnp.sin(angle) * cross + (1 - jnp.cos(angle)) * (cross @ cross)
