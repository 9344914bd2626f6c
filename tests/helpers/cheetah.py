"""A cheetah that runs at a given speed, without a policy."""

from __future__ import annotations

import mujoco
import numpy as np

from ear_jax.embeddings.trajectory import Trajectory


def running(cheetah: mujoco.MjModel, speed: float, steps: int = 100, fell: bool = False) -> Trajectory:
    """Returns the cheetah in its own pose, carried along x at `speed` m/s with 20 poses a second."""
    qpos = np.tile(cheetah.qpos0, (steps + 1, 1))
    qpos[:, 0] = speed * np.arange(steps + 1) / 20
    return Trajectory(qpos, fell, {}, speed)
