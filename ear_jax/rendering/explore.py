"""Data of the page of `ear explore`: for LTEs all over the sphere, a short segment of a roll-out that repeats."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from ear_jax.embeddings.codes import spread_codes
from ear_jax.embeddings.map import check_sphere, training_ltes
from ear_jax.embeddings.trajectory import Trajectory, follow
from ear_jax.figures.explore import Loop
from ear_jax.rendering.film import FILM_ELEVATION, FRAME_SECONDS
from ear_jax.rendering.scene import limbs, locomotion_of, project
from ear_jax.runs.rollouts import check_rollouts
from ear_jax.runs.trained import Trained, policy_of

SHORTEST, LONGEST = 1.0, 1.6  # length of a segment in seconds, if the roll-out is long enough


def play_sphere(trained: Trained, policy: int, places: int, steps: int, seed: int) -> tuple[dict[str, Any], list[Loop]]:
    """Plays codes spread over the sphere and returns the page's data and loops, for `figures.explore.write_page`.

    Args:
      trained: the run.
      policy: index of the policy; 0 is the first seed's.
      places: number of codes.
      steps: environment steps per code, of which the second half is kept.
      seed: seeds the start, which all codes share.

    Raises:
      UsageError: the agent has no LTEs, or they do not lie on a sphere in three dimensions.
    """
    check_sphere(trained, 3)
    program, family = trained.program, trained.program.family
    check_rollouts(program, places, steps + 1, family.model.nq)
    params, codes = policy_of(trained, policy), spread_codes(places, 3)
    trajectories = follow(program, params, jnp.asarray(codes), steps, jax.random.key(seed))
    model, every = family.portrait(), max(1, round(FRAME_SECONDS / family.dt))
    document = {
        "commanded": {**family.quantity, "period": family.period},
        "seconds": every * family.dt,
        "elevation": FILM_ELEVATION[locomotion_of(model)],
        "radii": np.round(limbs(model, trajectories[0].qpos[:1]).radii, 4).tolist(),
        "ltes": np.round(codes, 4).tolist(),
        "achieved": [round(trajectory.achieved, 4) for trajectory in trajectories],
        "trained": training_ltes(program.tasks, np.asarray(program.agent.codes(params))),
    }
    return document, [loop(model, trajectory, every, every * family.dt) for trajectory in trajectories]


def loop(model: mujoco.MjModel, trajectory: Trajectory, every: int, seconds: float) -> Loop:
    """Cuts the segment of a trajectory's second half that repeats best, or all of that half if the robot fell.

    Args:
      model: the robot.
      trajectory: the trajectory.
      every: environment steps from one picture to the next.
      seconds: the same in seconds.
    """
    locomotion = locomotion_of(model)
    robot = limbs(model, trajectory.qpos[len(trajectory.qpos) // 2 :: every])
    ground = robot.centres * (1, 1, 0)  # [pictures, 3]
    if locomotion == "fixed":
        ground = np.zeros_like(ground)
    shown = project(robot.ends - ground[:, None, None], FILM_ELEVATION[locomotion])
    if trajectory.fell or len(shown) < 3:
        return Loop(shown, np.concatenate([ground, ground[-1:]])[:, :2], trajectory.fell)
    least = min(round(SHORTEST / seconds), len(shown) // 2)
    first, last = _seam(shown, least, max(least, round(LONGEST / seconds)))
    return Loop(shown[first:last], ground[first : last + 1, :2], trajectory.fell)


def _seam(shown: np.ndarray, least: int, most: int) -> tuple[int, int]:
    """Returns the indices of two of [pictures, …], `least` to `most` apart, at which the loop closes best.

    There the two pictures, and the pictures after them, differ least.
    """
    flat = shown.reshape(len(shown), -1)
    moments = np.arange(len(flat) - 1)  # the last picture has no next one
    gap = moments[None, :] - moments[:, None]
    first, last = np.nonzero((gap >= least) & (gap <= most))
    distance = np.sum((flat[first] - flat[last]) ** 2 + (flat[first + 1] - flat[last + 1]) ** 2, axis=1)
    best = int(np.argmin(distance))
    return int(first[best]), int(last[best])
