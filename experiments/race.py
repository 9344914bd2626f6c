"""Draws `docs/images/race.gif`, README's film: one policy under two trained LTEs and a blend of them, from one start.

    python -m experiments.race

The camera does not move, so that the robots visibly draw apart. Needs OpenGL and takes half a minute.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from ear_jax.cli.exits import exit_code
from ear_jax.embeddings.codes import blend
from ear_jax.embeddings.trajectory import Trajectory, follow
from ear_jax.figures.video import caption, write_gif
from ear_jax.rendering.film import STRIP_ELEVATION, arrange
from ear_jax.rendering.scene import Canvas, camera_without_perspective
from ear_jax.runs.trained import load, policy_of

AGENT, SLOW, FAST, BETA = "pretrained:halfcheetah-vel", 0, 1, 0.5  # rows of its table of LTEs: 1 and 2 m/s
PICTURE = Path(__file__).parents[1] / "docs" / "images" / "race.gif"
STEPS = 100  # 5 s
WIDTH = 760  # pixels
HEADROOM = 0.35  # metres above the robot, for the line of text
GAP = 3  # white pixels below each row
HELD = 20  # pictures for which the end is held, 1 s


def race(
    model: mujoco.MjModel, trajectories: Sequence[Trajectory], names: Sequence[str], dt: float, width: int = WIDTH
) -> list[np.ndarray]:
    """Films robots that run along x, a row each, with a camera that does not move.

    Args:
      model: the robot.
      trajectories: where each went; one that ends early stays where it ended.
      names: the text of each row, which goes on with the metres covered and the mean speed so far.
      dt: seconds in one environment step.
      width: of the film in pixels.

    Returns:
      A picture [height, width, 3] for each environment step.

    Raises:
      RunError: no OpenGL that draws off the screen.
    """
    bounds = arrange(model, trajectories, names, dt).bounds
    bounds = replace(bounds, high=bounds.high + HEADROOM)
    high = bounds.high - bounds.low
    camera = camera_without_perspective(bounds, STRIP_ELEVATION["runs"])
    height = round(width * high / (bounds.right - bounds.left))

    def row(canvas: Canvas, name: str, trajectory: Trajectory, moment: int) -> np.ndarray:
        pose = trajectory.qpos[[min(moment, len(trajectory.qpos) - 1)]]
        covered = pose[0, 0] - trajectory.qpos[0, 0]
        drawn = caption(canvas.draw(pose, camera, high), f"{name} · {covered:.1f} m after {moment * dt:.1f} s")
        return np.pad(drawn, ((0, GAP), (0, 0), (0, 0)), constant_values=255)

    with Canvas(model, width, height) as canvas:
        return [
            np.concatenate([row(canvas, *named, moment) for named in zip(names, trajectories, strict=True)])
            for moment in range(max(len(trajectory.qpos) for trajectory in trajectories))
        ]


def main(path: Path = PICTURE) -> None:
    trained = load(Path(AGENT))
    program, agent = trained.program, trained.program.agent
    policy = policy_of(trained, 0)
    table = agent.codes(policy)
    between = blend(table[SLOW], table[FAST], jnp.float32(BETA), agent.project)
    codes = jnp.stack([table[SLOW], between, table[FAST]])
    trajectories = follow(program, policy, codes, STEPS, jax.random.key(0))
    slow, fast = (f"trained: {program.tasks.tasks[row].target:g} m/s" for row in (SLOW, FAST))
    names = (slow, "half-and-half blend, never trained", fast)
    family = program.family
    pictures = race(family.portrait(), trajectories, names, family.dt)
    print(write_gif(path, pictures + pictures[-1:] * HELD, family.dt))


if __name__ == "__main__":
    sys.exit(exit_code("experiments.race", main))
