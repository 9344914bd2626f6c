"""Composition: outcomes along β for an agent that obeys its code, and contacts of feet with the ground."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

from ear_jax.config import Config
from ear_jax.embeddings.compose import compose, contacts
from ear_jax.embeddings.interpolate import trained_ends
from ear_jax.envs import make_family
from ear_jax.figures.compose import draw_compose
from ear_jax.runs.trained import Trained
from ear_jax.runs.training import Program
from tests.helpers.documented import check_keys
from tests.helpers.obedient import CODES, obedient
from tests.helpers.probe import Slider


def test_outcomes_follow_the_formula_past_the_time_limit():
    """The blend's first number is b/√(b² + 3), b = 1 − 2β."""
    slider = Slider("native")
    program = Program(Config("slider"), slider, slider.training_tasks(), obedient(CODES), None)  # type: ignore[arg-type]
    trained = Trained("toy", program, jnp.zeros((1, 1)), 0)
    betas = (1.0, 0.5, 0.25)
    document = compose(trained, *trained_ends(trained), betas, steps=9, seed=0)
    check_keys("composition", document)
    blends = document["seeds"][0]["blends"]
    b = 1 - 2 * np.array(betas)
    np.testing.assert_allclose([blend["outcome"]["action"] for blend in blends], b / np.sqrt(b**2 + 3), atol=1e-4)
    assert [blend["length"] for blend in blends] == [9, 9, 9]
    assert [blend["beta"] for blend in blends] == list(betas)


def test_feet_touch_the_ground_where_they_must():
    family = make_family("halfcheetah-vel", "native")
    in_the_air, sunk, rearing = (np.zeros(family.model.nq) for _ in range(3))
    in_the_air[1], sunk[1] = 1.0, -0.2
    rearing[2] = -0.5  # radians, nose up: the hind foot alone is down
    found = contacts(family.model, np.stack([in_the_air, sunk, rearing]), family.feet)
    np.testing.assert_array_equal(found, [[False, False], [True, True], [True, False]])


@pytest.mark.parametrize("feet", [[], ["hind", "front"]])
def test_gaits_are_drawn_with_and_without_feet(tmp_path, feet):
    pattern = [[step % 2, 1 - step % 2][: len(feet)] for step in range(20)]
    blends = [{"beta": beta, "outcome": {"velocity": beta, "height": 0.1}, "pattern": pattern} for beta in (1.0, 0.0)]
    document = {
        "between": ["walk", "stand"],
        "dt": 0.05,
        "commanded": {"outcome": "velocity", "unit": "m/s"},
        "feet": feet,
        "seeds": [{"seed": 3, "blends": blends}],
    }
    (picture,) = draw_compose(tmp_path, document)
    assert picture.name == "compose_walk_to_stand_seed3.png"
    assert picture.stat().st_size > 10_000
