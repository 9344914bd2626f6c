"""Walker-Vel: a planar two-legged walker moves forward at a commanded speed and must not fall."""

from __future__ import annotations

from typing import ClassVar

import jax
import jax.numpy as jnp

from ear_jax.envs.velocity import LEGGED_PRESETS, LeggedVelocityFamily
from ear_jax.physics import Physics


class WalkerVel(LeggedVelocityFamily):
    """Reward 1 − |v − v*| − 0.001 Σa² a step, v* = 0.2 … 2.0 m/s; fails as Gym's Walker2d-v2 does."""

    name = "walker-vel"
    model_file = "walker2d.xml"
    feet: ClassVar[dict[str, str]] = {"right": "foot", "left": "foot_left"}
    mjx_solver = (6, 12)  # worst error of a step in qpos 1.5e-6, and no less with more iterations; (4, 8): 5.1e-4
    alive_bonus = 1.0
    presets = LEGGED_PRESETS

    def terminated(self, physics: Physics) -> jax.Array:
        """Returns True outside 0.8 to 2 m of height, or at a tilt of 1 rad."""
        height, angle = physics.qpos[1], physics.qpos[2]
        return ~((height > 0.8) & (height < 2.0) & (jnp.abs(angle) < 1.0))


FAMILY = WalkerVel
