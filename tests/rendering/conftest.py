"""A robot that several files draw."""

from __future__ import annotations

import mujoco
import pytest

from ear_jax.physics.models import load_model


@pytest.fixture(scope="session")
def cheetah() -> mujoco.MjModel:
    return load_model("half_cheetah.xml")
