"""The simulation state that all engines share, and the result of one step."""

from __future__ import annotations

from typing import Protocol

import jax
import mujoco
from flax import struct

from ear_jax.errors import UsageError


@struct.dataclass
class Physics:
    """One simulation's MuJoCo state, the same on every engine, so that a run can change engines."""

    qpos: jax.Array  # [nq] generalised positions
    qvel: jax.Array  # [nv] generalised velocities
    warmstart: jax.Array  # [nv] last acceleration, from which the constraint solver starts
    mocap: jax.Array | None = None  # [nmocap, 3] metres, positions of mocap bodies in models that have them
    act: jax.Array | None = None  # [na] activations of actuators, in models whose actuators have states of their own


def check_state(model: mujoco.MjModel) -> None:
    """Raises UsageError for a model that remembers more from step to step than a `Physics` holds (`mjtState`)."""
    hidden = {
        "delays of actuators or sensors": model.nhistory,
        "plugins with a state": model.npluginstate,
        "bodies that fall asleep": model.opt.enableflags & mujoco.mjtEnableBit.mjENBL_SLEEP,
    }
    for name, present in hidden.items():
        if present:
            raise UsageError(f"the model has {name}, which a run cannot carry from step to step; leave them out")


@struct.dataclass
class Motion:
    """One environment step of one simulation, from which a family computes its outcome."""

    before: Physics
    action: jax.Array  # [nu] control held during the step
    after: Physics
    positions: jax.Array  # [bodies, 3] metres, of the family's tracked `bodies` in `after`


class Engine(Protocol):
    """Steps one simulation; `jax.vmap` batches it."""

    name: str

    def step(self, physics: Physics, action: jax.Array) -> Motion:
        """Holds `action` [nu] for one environment step."""
        ...
