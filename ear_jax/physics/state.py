"""The simulation state that all engines share, and what one step of it yields."""

from __future__ import annotations

from typing import Protocol

import jax
from flax import struct


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
