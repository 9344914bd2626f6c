"""C MuJoCo on a thread pool, called from compiled JAX code."""

from __future__ import annotations

import copy
import math
import threading
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jax.experimental.buffer_callback import buffer_callback
from mujoco.batch import Batch

from ear_jax.errors import RunError
from ear_jax.physics.kinematics import body_positions
from ear_jax.physics.state import Motion, Physics
from ear_jax.process.progress import env_steps
from ear_jax.process.target import on_accelerator


class NativeEngine:
    """Steps with `mujoco.batch`; all simulations that `step` is vmapped over arrive in one call.

    The callback reads and writes XLA's buffers in place and never calls JAX. `jax.pure_callback` would copy each
    argument through `device_put`, which costs 5 % of the cheetah's step and can deadlock: the copy may need the thread
    pool that the callback blocks.
    """

    name = "native"

    def __init__(self, model: mujoco.MjModel, substeps: int, body_ids: list[int]):
        self._model = copy.copy(model)
        # As in MJX, a state that is not finite stays so; by default C MuJoCo would silently reset it.
        self._model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self._substeps = substeps
        self._positions = body_positions(model, body_ids)
        if mujoco.get_mju_user_warning() is None:
            mujoco.set_mju_user_warning(_ignore)
        self._lock = threading.Lock()  # a step releases the GIL, so another thread or device may call
        self._pools: dict[int, _Pool] = {}  # by number of simulations; each holds threads and MjData

    def step(self, physics: Physics, action: jax.Array) -> Motion:
        if on_accelerator():
            raise RunError(
                f"engine 'native' steps on the CPU, but JAX runs on {jax.default_backend()} here; "
                "use 'mjx' or JAX_PLATFORMS=cpu"
            )
        model = self._model
        sizes = (model.nq, model.nv, model.nv, *((model.na,) if model.na else ()))
        results = tuple(jax.ShapeDtypeStruct((size,), jnp.float32) for size in sizes)
        step = buffer_callback(self._step_batch, results, vmap_method="broadcast_all")
        optional = tuple(field for field in (physics.act, physics.mocap) if field is not None)
        qpos, qvel, warmstart, *act = step(physics.qpos, physics.qvel, physics.warmstart, action, *optional)
        return Motion(physics, action, Physics(qpos, qvel, warmstart, physics.mocap, *act), self._positions(qpos))

    def _step_batch(self, context, outputs, *inputs) -> None:
        """Runs on the host with the buffers of the whole batch, whose leading axes are the vmapped ones."""
        arrays = [np.asarray(buffer) for buffer in inputs]
        count = math.prod(arrays[0].shape[:-1])
        with self._lock:
            pool = self._pools.get(count) or self._make_pool(count)
            for field, array in zip(pool.inputs, arrays, strict=True):
                field[...] = array.reshape(field.shape)
            pool.batch.step(nstep=self._substeps)
            env_steps.add(count)
            for output, field in zip(outputs, pool.outputs, strict=True):
                buffer = np.asarray(output)
                buffer.reshape(field.shape)[...] = field

    def _make_pool(self, count: int) -> _Pool:
        batch = Batch(self._model, count)
        state, act = (batch.qpos, batch.qvel, batch.qacc_warmstart), (batch.act,) if self._model.na else ()
        mocap = (batch.mocap_pos,) if self._model.nmocap else ()
        self._pools[count] = _Pool(batch, (*state, batch.ctrl, *act, *mocap), (*state, *act))
        return self._pools[count]


def _ignore(warning: str) -> None:
    """Keeps MuJoCo from writing a MUJOCO_LOG.TXT in the user's directory; `BatchedEnv` marks invalid steps instead."""


@dataclass(frozen=True)
class _Pool:
    """Simulations with views of their state, kept because looking up a view costs as much as copying it."""

    batch: Batch
    inputs: tuple[np.ndarray, ...]  # each [simulations, size], float64
    outputs: tuple[np.ndarray, ...]
