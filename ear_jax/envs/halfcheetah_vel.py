"""HalfCheetah-Vel: a planar cheetah runs forward at a commanded speed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import jax
import jax.numpy as jnp

from ear_jax.envs.family import Family
from ear_jax.envs.velocity import VelocityFamily
from ear_jax.physics import Physics


class HalfCheetah(Family):
    """The robot of Gym's HalfCheetah-v2, whose episodes never terminate."""

    model_file = "half_cheetah.xml"
    substeps = 5
    feet: ClassVar[dict[str, str]] = {"hind": "bfoot", "front": "ffoot"}
    mjx_solver = (4, 8)  # worst error of a step in qpos 3.8e-5; more iterations do not lower it

    def initial(self, key: jax.Array) -> Physics:
        return self.noisy_start(key, 0.1, lambda key, shape: 0.1 * jax.random.normal(key, shape))

    def observe(self, physics: Physics) -> jax.Array:
        return jnp.concatenate([physics.qpos[1:], physics.qvel])


class HalfCheetahVel(HalfCheetah, VelocityFamily):
    """Reward −|v − v*| − 0.1 Σa² a step, v* = 1 … 10 m/s."""

    name = "halfcheetah-vel"
    speeds = tuple(float(speed) for speed in range(1, 11))
    adaptation_range = (1.0, 10.0)
    control_cost = 0.1
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {"smoke": {"tasks": ("1", "2", "3")}}


FAMILY = HalfCheetahVel
