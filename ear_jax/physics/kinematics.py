"""Where bodies are, from generalised positions alone; the same on every engine."""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
import mujoco

from ear_jax.quiet import mjx


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
