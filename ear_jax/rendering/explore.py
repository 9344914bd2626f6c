"""The sphere of codes as something to steer by: what a robot does at every place, as a short piece that repeats."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from ear_jax.embeddings.codes import spread_codes
from ear_jax.embeddings.map import check_sphere
from ear_jax.embeddings.trajectory import Trajectory, follow
from ear_jax.figures.explore import Loop
from ear_jax.rendering.film import FILM_ELEVATION, FRAME_SECONDS
from ear_jax.rendering.scene import limbs, project, way_of
from ear_jax.runs.trained import Trained

SHORTEST, LONGEST = 1.0, 1.6  # seconds of a piece that repeats, where there is as much


def play_sphere(trained: Trained, policy: int, places: int, steps: int, seed: int) -> tuple[dict[str, Any], list[Loop]]:
    """Plays codes spread over the sphere, as `report.explorer.write_page` takes them.

    Args:
      trained: the run.
      policy: of its seeds, whose.
      places: how many codes.
      steps: environment steps under each, all from one start; of these the second half is kept.
      seed: of that start.

    Raises:
      UsageError: an agent without LTEs, or whose LTEs do not lie on a sphere in three dimensions.
    """
    check_sphere(trained, 3)
    program, family = trained.program, trained.program.family
    params = jax.tree.map(lambda leaf: leaf[policy], trained.policies)
    codes, table = spread_codes(places, 3), np.asarray(program.agent.codes(params))
    trajectories = follow(program, params, jnp.asarray(codes), steps, jax.random.key(seed))
    model, every = family.portrait(), max(1, round(FRAME_SECONDS / family.dt))
    document = {
        "commanded": {**family.quantity, "period": family.period},
        "seconds": every * family.dt,
        "elevation": FILM_ELEVATION[way_of(model)],
        "radii": np.round(limbs(model, trajectories[0].qpos[:1]).radii, 4).tolist(),
        "ltes": np.round(codes, 4).tolist(),
        "achieved": [round(trajectory.achieved, 4) for trajectory in trajectories],
        "trained": [
            {"name": task.name, "target": task.target, "lte": code.tolist()}
            for task, code in zip(program.tasks.tasks, table, strict=True)
        ],
    }
    return document, [loop(model, trajectory, every, every * family.dt) for trajectory in trajectories]


def loop(model: mujoco.MjModel, trajectory: Trajectory, every: int, seconds: float) -> Loop:
    """The piece of a trajectory's second half that repeats best; of one that fell, all of it.

    Args:
      model: the robot.
      trajectory: where it went.
      every: environment steps from one picture to the next.
      seconds: the same in seconds.
    """
    seen = limbs(model, trajectory.qpos[len(trajectory.qpos) // 2 :: every])
    ground = seen.centres * (1, 1, 0)  # [pictures, 3]
    if way_of(model) == "stands":
        ground = np.zeros_like(ground)
    shown = project(seen.ends - ground[:, None, None], FILM_ELEVATION[way_of(model)])
    if trajectory.fell or len(shown) < 3:
        return Loop(shown, np.concatenate([ground, ground[-1:]])[:, :2], trajectory.fell)
    least = min(round(SHORTEST / seconds), len(shown) // 2)
    first, last = _seam(shown, least, max(least, round(LONGEST / seconds)))
    return Loop(shown[first:last], ground[first : last + 1, :2], trajectory.fell)


def _seam(shown: np.ndarray, least: int, most: int) -> tuple[int, int]:
    """Two pictures of [pictures, …], `least` to `most` apart, that are most alike, as are those after them."""
    flat = shown.reshape(len(shown), -1)
    moments = np.arange(len(flat) - 1)  # the last has none after it
    gap = moments[None, :] - moments[:, None]
    first, last = np.nonzero((gap >= least) & (gap <= most))
    apart = np.sum((flat[first] - flat[last]) ** 2 + (flat[first + 1] - flat[last + 1]) ** 2, axis=1)
    best = int(np.argmin(apart))
    return int(first[best]), int(last[best])
