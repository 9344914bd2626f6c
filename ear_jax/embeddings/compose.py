"""Composition: what a policy does between two tasks of different kinds, and how its feet touch the ground there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from ear_jax.agents.networks import Params
from ear_jax.embeddings.codes import blend
from ear_jax.embeddings.interpolate import End
from ear_jax.embeddings.trajectory import Trajectory, follow
from ear_jax.runs.trained import Trained

BETAS = tuple(round(0.1 * step, 1) for step in range(10, -1, -1))
SHOWN = 100  # steps of the contact pattern that are kept, the last


def compose(trained: Trained, first: End, second: End, betas: Sequence[float], steps: int, seed: int) -> dict[str, Any]:
    """Rolls out every blend of two codes, longer than the episodes of training.

    Args:
      trained: the run.
      first, second: at β = 1 and at β = 0 (equation 1).
      betas: the blends.
      steps: environment steps of each.
      seed: of the start, the same for all.

    Returns:
      What `ear compose --json` prints. Outcomes are means over the second half.
    """
    program = trained.program
    seeds = []
    for index in range(program.config.seeds):
        policy: Params = jax.tree.map(lambda leaf, index=index: leaf[index], trained.policies)
        one, other = (jnp.asarray(end.codes[index]) for end in (first, second))
        codes = jnp.stack([blend(one, other, jnp.float32(beta), program.agent.project) for beta in betas])
        followed = follow(program, policy, codes, steps, jax.random.key(seed))
        blends = [
            {"beta": beta, **_describe(trained, trajectory)} for beta, trajectory in zip(betas, followed, strict=True)
        ]
        seeds.append({"seed": program.config.seed + index, "blends": blends})
    family = program.family
    return {
        "between": [first.name, second.name],
        "steps": steps,
        "dt": round(family.dt, 6),
        "commanded": family.quantity,
        "feet": list(family.feet),
        "seeds": seeds,
    }


def _describe(trained: Trained, trajectory: Trajectory) -> dict[str, Any]:
    family, length = trained.program.family, len(trajectory.qpos) - 1
    late = {name: float(values[length // 2 :].mean()) for name, values in trajectory.outcomes.items()}
    touching = contacts(family.model, trajectory.qpos[1:], family.feet)
    settled = touching[length // 2 :]
    return {
        "length": length,
        "fell": trajectory.fell,
        "outcome": {**late, family.commanded: trajectory.achieved},
        "contact": {foot: float(settled[:, column].mean()) for column, foot in enumerate(family.feet)},
        "airborne": float((~settled.any(axis=1)).mean()) if family.feet else None,
        "pattern": [[int(foot) for foot in step] for step in touching[-SHOWN:]],
    }


def contacts(model: mujoco.MjModel, qpos: np.ndarray, feet: Mapping[str, str]) -> np.ndarray:
    """Which feet touch anything but the robot, in poses [poses, nq]: bool [poses, feet].

    Args:
      model: the robot.
      qpos: the poses.
      feet: bodies by what to call them.
    """
    data = mujoco.MjData(model)
    bodies = [model.body(body).id for body in feet.values()]
    touching = np.zeros((len(qpos), len(bodies)), bool)
    for row, pose in enumerate(qpos):
        data.qpos[:] = pose
        mujoco.mj_fwdPosition(model, data)
        pairs = model.geom_bodyid[data.contact.geom].reshape(-1, 2)
        ground = pairs[(model.body_weldid[pairs] == 0).any(axis=1)]
        touching[row] = [(ground == body).any() for body in bodies]
    return touching
