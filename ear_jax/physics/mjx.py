"""MuJoCo XLA (JAX implementation): the whole step on the device."""

from __future__ import annotations

import copy

import jax
import jax.numpy as jnp
import mujoco

from ear_jax.physics.engine import Motion, Physics
from ear_jax.quiet import mjx


class MjxEngine:
    """Steps with `mujoco.mjx`, differentiable and free of the host."""

    name = "mjx"

    def __init__(self, model: mujoco.MjModel, substeps: int, body_ids: list[int], solver: tuple[int, int]):
        model = copy.copy(model)
        model.opt.iterations, model.opt.ls_iterations = solver
        self._model = mjx.put_model(model, impl="jax")
        self._blank = mjx.make_data(model, impl="jax")
        self._substeps = substeps
        self._body_ids = jnp.asarray(body_ids, jnp.int32)

    def step(self, physics: Physics, action: jax.Array) -> Motion:
        data = self._blank.replace(qpos=physics.qpos, qvel=physics.qvel, qacc_warmstart=physics.warmstart, ctrl=action)
        data, _ = jax.lax.scan(lambda data, _: (mjx.step(self._model, data), None), data, length=self._substeps)
        positions = jnp.zeros((0, 3))
        if self._body_ids.size:
            positions = mjx.kinematics(self._model, data).xpos[self._body_ids]
        return Motion(physics, action, Physics(data.qpos, data.qvel, data.qacc_warmstart), positions)
