"""Composition: blends of two tasks of different kinds, their outcomes and their ground contacts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import jax
import mujoco
import numpy as np

from ear_jax.embeddings.interpolate import End, blend_codes
from ear_jax.embeddings.trajectory import Trajectory, follow
from ear_jax.envs import Family
from ear_jax.runs.trained import Trained, policy_of

SHOWN = 100  # last steps of the contact pattern that the document keeps


def compose(trained: Trained, first: End, second: End, betas: Sequence[float], steps: int, seed: int) -> dict[str, Any]:
    """Rolls out blends of two codes, longer than the episodes of training.

    Args:
      trained: the run.
      first, second: the codes at β = 1 and at β = 0 (equation 1).
      betas: β of each blend.
      steps: environment steps per blend.
      seed: seeds the start, which all blends share.

    Returns:
      The document that `ear compose --json` prints; outcomes are means over the second half of the steps.
    """
    program = trained.program
    seeds = []
    for index in range(program.config.seeds):
        codes = blend_codes(program.agent, first.codes[index], second.codes[index], betas)
        trajectories = follow(program, policy_of(trained, index), codes, steps, jax.random.key(seed))
        blends = [
            {"beta": beta, **_describe(program.family, trajectory)}
            for beta, trajectory in zip(betas, trajectories, strict=True)
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


def _describe(family: Family, trajectory: Trajectory) -> dict[str, Any]:
    length = len(trajectory.qpos) - 1
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
    """Returns which feet touch the ground, or anything else fixed to the world: bool [poses, feet].

    Args:
      model: the robot.
      qpos: poses [poses, nq].
      feet: body names by foot.
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
