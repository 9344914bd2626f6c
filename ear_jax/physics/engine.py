"""The choice of a physics engine."""

from __future__ import annotations

import jax
import mujoco

from ear_jax.errors import known_name, unknown
from ear_jax.names import ENGINES
from ear_jax.physics.native import NativeEngine
from ear_jax.physics.state import Engine, check_state


def choose_engine(name: str) -> str:
    """Resolves `auto` by JAX's backend; raises UsageError for an unknown engine."""
    name = known_name("engine", name, ("auto", *ENGINES))
    if name == "auto":
        return "native" if jax.default_backend() == "cpu" else "mjx"
    return name


def make_engine(
    name: str, model: mujoco.MjModel, substeps: int, bodies: tuple[str, ...], mjx_solver: tuple[int, int]
) -> Engine:
    """Builds an engine for one model.

    Args:
      name: an engine of `ENGINES`, or `auto`.
      model: the compiled model.
      substeps: MuJoCo steps in one environment step.
      bodies: names of the bodies whose positions each step reports.
      mjx_solver: limits on MJX's solver and line-search iterations. C MuJoCo stops once converged, but MJX under `vmap`
        always waits for the slowest simulation.

    Raises:
      UsageError: the engine or a body is unknown, or the model has a state that `Physics` does not hold.
      RunError: the engine does not run here.
    """
    check_state(model)
    body_ids = [_body_id(model, body) for body in bodies]
    name = choose_engine(name)
    if name == "native":
        return NativeEngine(model, substeps, body_ids)
    from ear_jax.physics.mjx import MjxEngine  # MJX takes two seconds to import

    return MjxEngine(model, substeps, body_ids, mjx_solver, name)


def _body_id(model: mujoco.MjModel, name: str) -> int:
    names = [model.body(index).name for index in range(model.nbody)]
    if name not in names:
        raise unknown("body", name, names)
    return names.index(name)
