"""MuJoCo XLA: the whole step runs on the device, in JAX or in NVIDIA Warp's kernels."""

from __future__ import annotations

import copy
import importlib.util
from typing import Any

import jax
import mujoco

from ear_jax.errors import RunError
from ear_jax.physics.fixed_solver import solver_of_mjx
from ear_jax.physics.kinematics import body_positions
from ear_jax.physics.state import Motion, Physics
from ear_jax.process.silent_imports import mjx

# Warp allocates contacts for the whole batch together and constraints for each simulation. Our robots need at most 8
# contacts and 128 constraints each.
WARP_CONTACTS = 8 * 65_536
WARP_CONSTRAINTS = 128


class MjxEngine:
    """Steps with `mujoco.mjx`, without calling the host; as `mjx-fixed` with the solver of `fixed_solver.py`."""

    def __init__(self, model: mujoco.MjModel, substeps: int, body_ids: list[int], solver: tuple[int, int], name: str):
        model = copy.copy(model)
        model.opt.iterations, model.opt.ls_iterations = solver
        self.name = name
        self._substeps = substeps
        self._fixed = solver[0] if name == "mjx-fixed" else None
        self._positions = body_positions(model, body_ids)
        self._model, self._blank = _warp(model) if name == "warp" else _jax(model)

    def step(self, physics: Physics, action: jax.Array) -> Motion:
        data = self._blank.replace(qpos=physics.qpos, qvel=physics.qvel, qacc_warmstart=physics.warmstart, ctrl=action)
        if physics.mocap is not None:
            data = data.replace(mocap_pos=physics.mocap)
        if physics.act is not None:
            data = data.replace(act=physics.act)
        # A GPU's default rounds mantissas to 10 bits.
        with jax.default_matmul_precision("highest"), solver_of_mjx(self._fixed):
            data, _ = jax.lax.scan(lambda data, _: (mjx.step(self._model, data), None), data, length=self._substeps)
        act = None if physics.act is None else data.act
        after = Physics(data.qpos, data.qvel, data.qacc_warmstart, physics.mocap, act)
        return Motion(physics, action, after, self._positions(data.qpos))


def _jax(model: mujoco.MjModel) -> tuple[Any, Any]:
    return mjx.put_model(model, impl="jax"), mjx.make_data(model, impl="jax")


def _warp(model: mujoco.MjModel) -> tuple[Any, Any]:
    if importlib.util.find_spec("warp") is None:
        raise RunError("engine 'warp' needs NVIDIA's warp-lang, which is not installed: pip install 'ear-jax[warp]'")
    import warp

    warp.config.quiet = True  # otherwise it prints every kernel it compiles on stdout
    data = mjx.make_data(model, impl="warp", naconmax=WARP_CONTACTS, njmax=WARP_CONSTRAINTS)
    return mjx.put_model(model, impl="warp"), data
