"""Where bodies are, from generalised positions alone; the same on every engine."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from ear_jax.quiet import mjx

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


def body_point(model: mujoco.MjModel, name: str, point: np.ndarray | None = None) -> Callable[[jax.Array], jax.Array]:
    """Maps qpos [nq] to where a point [3] of a body is, by default its origin; [3] metres.

    The body hangs from hinges and slides. MJX's kinematics tell it too, but XLA's CPU compiler fuses a chain of links
    and computes each anew for all that come after: for an arm of seven joints a call took seconds. A matmul a link
    keeps them apart.
    """
    links, body = [], model.body(name).id
    while body:
        links.append(body)
        body = int(model.body_parentid[body])
    parts = [(model.body_pos[body], _rotation(model.body_quat[body]), _joint(model, body)) for body in links[::-1]]

    def position(qpos: jax.Array) -> jax.Array:
        origin, rotation = jnp.zeros(3), jnp.eye(3)
        for offset, turn, joint in parts:
            origin, rotation = origin + _product(rotation, offset), _product(rotation, turn)
            if joint is None:
                continue
            address, axis, slides = joint
            if slides:
                origin = origin + _product(rotation, axis) * qpos[address]
            else:
                rotation = _product(rotation, _about(axis, qpos[address]))
        return origin if point is None else origin + _product(rotation, point)

    return position


def _joint(model: mujoco.MjModel, body: int) -> tuple[int, np.ndarray, bool] | None:
    """The joint of a body that has one at its own place: where in qpos, its axis, and whether it slides."""
    if not model.body_jntnum[body]:
        return None
    joint = int(model.body_jntadr[body])
    return int(model.jnt_qposadr[joint]), model.jnt_axis[joint], model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE


def _rotation(quaternion: np.ndarray) -> np.ndarray:
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)


def _about(axis: np.ndarray, angle: jax.Array) -> jax.Array:
    """The rotation [3, 3] about a unit vector (Rodrigues)."""
    x, y, z = axis
    across = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return jnp.eye(3) + jnp.sin(angle) * across + (1 - jnp.cos(angle)) * (across @ across)
