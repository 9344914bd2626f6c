"""README's film: robots keep their place on one track, and text says how far each has come."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from ear_jax.embeddings.trajectory import Trajectory
from ear_jax.errors import RunError
from experiments.race import GAP, race

SLIDER = """<mujoco><worldbody>
  <light pos="0 0 5"/><geom type="plane" size="0 0 1"/>
  <body pos="0 0 0.5"><joint type="slide" axis="1 0 0"/><geom type="capsule" fromto="-.5 0 0 .5 0 0" size=".1"
    rgba="1 0 0 1"/></body>
</worldbody></mujoco>"""


def run(speed: float) -> Trajectory:
    """A roll-out of 20 steps of 0.1 s."""
    return Trajectory(0.1 * speed * np.arange(21.0)[:, None], False, {}, speed)


def test_the_faster_robot_draws_away_under_a_camera_that_stands_still():
    model = mujoco.MjModel.from_xml_string(SLIDER)
    try:
        pictures = race(model, [run(1.0), run(3.0)], ["slow", "fast"], 0.1, width=400)
    except RunError as error:
        pytest.skip(f"needs OpenGL: {error}")
    assert len(pictures) == 21
    assert len({picture.shape for picture in pictures}) == 1

    def places(picture: np.ndarray) -> list[float]:
        """The column of the red robot's middle in each row."""
        rows = np.split(picture.astype(int), 2)
        assert all(np.all(row[-GAP:] == 255) for row in rows)
        red = [(row[..., 0] - row[..., 1] > 80) for row in rows]
        return [float(np.nonzero(one)[1].mean()) for one in red]

    start, end = places(pictures[0]), places(pictures[-1])
    assert start[0] == pytest.approx(start[1], abs=1)
    slow, fast = (last - first for first, last in zip(start, end, strict=True))
    assert fast == pytest.approx(3 * slow, rel=0.1)
    assert slow > 20
