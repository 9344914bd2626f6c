"""The state every engine steps, what a step is told apart by, and the choice of engine."""

from __future__ import annotations

from typing import Protocol

import jax
import mujoco
from flax import struct

from ear_jax.errors import RunError, unknown

ENGINES = ("native", "mjx", "warp")


@struct.dataclass
class Physics:
    """One simulation's MuJoCo state: all that a step reads, the same on every engine, so a run can change engines."""

    qpos: jax.Array  # [nq] generalised positions
    qvel: jax.Array  # [nv] generalised velocities
    warmstart: jax.Array  # [nv] last acceleration, from which the constraint solver starts
    mocap: jax.Array | None = None  # [nmocap, 3] metres: where bodies stand that are moved by hand, in models with such


@struct.dataclass
class Motion:
    """One environment step of one simulation, as a family judges it."""

    before: Physics
    action: jax.Array  # [nu] control held during the step
    after: Physics
    positions: jax.Array  # [bodies, 3] metres: where the family's tracked bodies are in `after`


class Engine(Protocol):
    """Steps one simulation; `jax.vmap` batches it."""

    name: str

    def step(self, physics: Physics, action: jax.Array) -> Motion:
        """Holds `action` [nu] for one environment step."""
        ...


def choose_engine(name: str) -> str:
    """Resolves `auto` by the backend JAX runs on, and refuses what cannot run there.

    Raises:
      UsageError: there is no such engine.
      RunError: the engine does not run on this backend.
    """
    backend = jax.default_backend()
    if name == "auto":
        return "native" if backend == "cpu" else "mjx"
    if name not in ENGINES:
        raise unknown("engine", name, ("auto", *ENGINES))
    if name == "native" and backend != "cpu":
        raise RunError(
            f"engine 'native' steps on the CPU, and JAX runs on {backend} here; use 'mjx' or JAX_PLATFORMS=cpu"
        )
    return name


def make_engine(
    name: str, model: mujoco.MjModel, substeps: int, bodies: tuple[str, ...], mjx_solver: tuple[int, int]
) -> Engine:
    """An engine for one model.

    Args:
      name: an engine of `ENGINES`, or `auto`.
      model: the compiled model.
      substeps: MuJoCo steps in one environment step.
      bodies: names of the bodies whose positions each step reports.
      mjx_solver: solver and line-search iterations that MJX is held to (C MuJoCo stops by itself; MJX under `vmap`
        always pays for the slowest simulation).

    Raises:
      UsageError: there is no such engine or body.
      RunError: the engine does not run here.
    """
    body_ids = [_body_id(model, body) for body in bodies]
    name = choose_engine(name)
    if name == "native":
        from ear_jax.physics.native import NativeEngine

        return NativeEngine(model, substeps, body_ids)
    from ear_jax.physics.mjx import MjxEngine

    return MjxEngine(model, substeps, body_ids, mjx_solver, name)


def _body_id(model: mujoco.MjModel, name: str) -> int:
    names = [model.body(index).name for index in range(model.nbody)]
    if name not in names:
        raise unknown("body", name, names)
    return names.index(name)
