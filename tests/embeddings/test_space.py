"""Measures of a space of LTEs, for spaces whose measures are known."""

from __future__ import annotations

import numpy as np
import pytest

from ear_jax.embeddings.codes import fibonacci_sphere
from ear_jax.embeddings.space import measure_space
from ear_jax.envs.ant_dir import AntDir
from ear_jax.envs.halfcheetah_vel import HalfCheetahVel

CODES = fibonacci_sphere(2000)
LASTS = np.full(len(CODES), 200)
SPEEDS = np.arange(1.0, 11.0)


@pytest.fixture(scope="module")
def family() -> HalfCheetahVel:
    return HalfCheetahVel("native")


def along(speeds: np.ndarray) -> np.ndarray:
    """Returns the codes on a half circle where the ideal space has these speeds."""
    angle = np.pi * (speeds - 1) / 9
    return np.stack([np.sin(angle), 0 * angle, np.cos(angle)], axis=1)


def test_an_ideal_space_has_all_ones(family):
    """The speed grows evenly with the angle from the pole, 1 to 10 m/s over π radians."""
    speeds = 1 + 9 * np.arccos(CODES[:, 2]) / np.pi
    space = measure_space(family, CODES, speeds, LASTS, along(SPEEDS), list(SPEEDS))
    assert space["lipschitz"] == pytest.approx(9 / np.pi, rel=0.03)
    assert space["smooth"] == pytest.approx(1, abs=0.01)
    assert (space["lasting"], space["ordered"]) == (1, 1)
    assert space["covered"] >= 0.99, "the two poles are the ends of the range"
    assert space["space"] == pytest.approx(1, abs=0.01)


def test_each_fault_lowers_its_own_measure(family):
    speeds = 1 + 9 * np.arccos(CODES[:, 2]) / np.pi
    steep = measure_space(family, CODES, np.clip(3 * speeds - 11, 1, 10), LASTS, along(SPEEDS), list(SPEEDS))
    assert steep["smooth"] == pytest.approx(1 / 3, abs=0.02)
    assert (steep["lasting"], steep["covered"], steep["ordered"]) == (1, 1, 1)
    fallen = measure_space(family, CODES, speeds, np.where(speeds > 5.5, 20, 200), along(SPEEDS), list(SPEEDS))
    assert fallen["lasting"] == pytest.approx(0.5, abs=0.01)
    assert fallen["covered"] == pytest.approx(0.51, abs=0.02)
    mixed = measure_space(family, CODES, speeds, LASTS, along(SPEEDS[[9, 0, 5, 2, 7, 4, 1, 8, 3, 6]]), list(SPEEDS))
    assert mixed["ordered"] < 0.2
    assert mixed["space"] < 0.7


def test_directions_wrap():
    longitude = np.degrees(np.arctan2(CODES[:, 1], CODES[:, 0])) % 360
    angles = np.arange(0, 360, 15.0)
    tasks = np.stack([np.cos(np.radians(angles)), np.sin(np.radians(angles)), 0 * angles], axis=1)
    space = measure_space(AntDir("native"), CODES, longitude, LASTS, tasks, list(angles))
    assert (space["covered"], space["ordered"]) == (1, 1)
    assert 100 < space["steep"] < 200, "57 degrees per radian on the equator, and more toward the poles"


def test_tasks_without_targets_have_no_measure(family):
    assert measure_space(family, CODES, 0 * CODES[:, 0], LASTS, along(SPEEDS), [None] * 10) is None


def test_tasks_that_are_equally_far_apart_have_no_order():
    """Three directions, and three points of a great circle: every distance is 120 degrees."""
    angles = np.array([0.0, 120.0, 240.0])
    tasks = np.stack([np.cos(np.radians(angles)), np.sin(np.radians(angles)), 0 * angles], axis=1)
    longitude = np.degrees(np.arctan2(CODES[:, 1], CODES[:, 0])) % 360
    assert measure_space(AntDir("native"), CODES, longitude, LASTS, tasks, list(angles))["ordered"] == 0
