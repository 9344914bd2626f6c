"""Courses and splines, for an agent whose action is the first number of its code."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ear_jax.agents.networks import unit_vector
from ear_jax.config import Config
from ear_jax.embeddings.codes import fibonacci_sphere
from ear_jax.embeddings.course import path_course, profile_course
from ear_jax.embeddings.follow import Plan, look_up, search_spline, spline
from ear_jax.embeddings.survey import Survey
from ear_jax.envs.ant_dir import AntDir
from ear_jax.envs.halfcheetah_vel import HalfCheetahVel
from ear_jax.envs.reach import Reach
from ear_jax.errors import UsageError
from ear_jax.runs.training import Program
from tests.helpers.obedient import CODES, obedient
from tests.helpers.probe import Bandit


class Steady(Bandit):
    """Never ends; the outcome is the action."""

    def terminated(self, physics):
        return jnp.zeros((), bool)


@pytest.fixture(scope="module")
def ant() -> AntDir:
    return AntDir("native")


@pytest.fixture(scope="module")
def program() -> Program:
    family = Steady("native")
    return Program(Config("steady"), family, family.training_tasks(), obedient(CODES), None)  # type: ignore[arg-type]


def test_a_spline_passes_its_knots_and_stays_on_the_sphere():
    knots = jax.vmap(unit_vector)(jnp.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1]]))
    codes = spline(obedient(CODES), knots, 9)
    np.testing.assert_allclose(codes[::4], knots, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(codes, axis=1), 1, atol=1e-6)
    np.testing.assert_allclose(codes[2], [np.sqrt(0.5), np.sqrt(0.5), 0], atol=1e-6)


def test_the_search_finds_the_optimum(program):
    """The action that is wanted goes from −0.5 to 0.5; a knot's first number is the action there."""
    course = profile_course(program.family, "0:-0.5, 2:0.5")
    begin, plan = jnp.tile(jnp.array([0.0, 0.0, 1.0]), (5, 1)), Plan(epochs=20, candidates=48)
    knots, costs = jax.jit(lambda key: search_spline(program, jnp.zeros(1), begin, course, plan, key))(
        jax.random.key(0)
    )
    np.testing.assert_allclose(knots[:, 0], np.linspace(-0.5, 0.5, 5), atol=0.08)
    assert costs[0] > 10 * costs.min()
    assert costs.min() < 0.002


def test_a_look_up_meets_what_is_wanted(program):
    codes = fibonacci_sphere(2000)
    survey = Survey(codes, {"action": codes[None, :, :1].repeat(4, 2)}, np.full((1, 2000), 4, np.int32))
    course = profile_course(program.family, "0:-0.5, 1:0.5, 2:0")
    found = look_up(survey, 0, course, len(course.wanted))
    np.testing.assert_allclose(found[:, 0], course.wanted[:, 0], atol=0.06)


def test_the_error_of_a_profile_leaves_out_the_first_second():
    course = profile_course(HalfCheetahVel("native"), "0:1, 3:4")
    wanted = 1 + 0.05 * np.arange(1, 61)
    np.testing.assert_allclose(course.wanted[:, 0], wanted)
    off = jnp.where(jnp.arange(60) < 20, 9.0, wanted + 0.3)
    error, cost = course.error({"velocity": off}, jnp.ones(60, bool), 0.05)
    assert float(error) == pytest.approx(0.3, abs=1e-5)
    assert float(cost) > 1


def test_way_points_count_in_their_order(ant):
    """The robot runs 0.6 m beside two corners of a square; another one meets them in the wrong order."""
    course = path_course(ant, "2 0, 2 2, 0 2", 1.0)
    corners = np.array([[0, 0], [2, 0], [2, 2], [0, 2]], float)

    def error(corners: np.ndarray) -> float:
        moments = np.linspace(0, len(corners) - 1, 121)
        places = np.stack([np.interp(moments, range(len(corners)), column) for column in corners.T], axis=1)
        velocity = np.diff(places, axis=0) / 0.05
        outcome = {name: jnp.asarray(column, jnp.float32) for name, column in zip(ant.plane, velocity.T, strict=True)}
        return float(course.error(outcome, jnp.ones(120, bool), 0.05)[0])

    assert error(corners) == pytest.approx(0, abs=0.06)
    assert error(corners - np.array([[0, 0], [0.6, 0], [0.6, 0], [0, 0]])) == pytest.approx(0.6, abs=0.06)
    assert error(corners[[0, 3, 2, 1]]) > 1.5


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("0:1", "must begin at 0 seconds and go on"),
        ("1:1, 3:2", "must begin at 0 seconds"),
        ("0:1, 2:3, 2:4", "must begin at 0 seconds"),
        ("0:1, 3", "'3' is not seconds:value, as in 0:1, 3:6, 6:2"),
        ("0:1, 3:x", "'3:x' is not seconds:value"),
        ("0:1, 3:nan", "'3:nan' is not seconds:value"),
        ("0:1, 1:2", "takes 1 s; it must be from 2 to 60"),
        ("0:1, 1e9:2", "takes 1e"),
    ],
)
def test_a_bad_profile_is_one_line(text, complaint):
    with pytest.raises(UsageError, match=complaint):
        profile_course(HalfCheetahVel("native"), text)


def test_each_family_says_what_it_can_follow(ant):
    with pytest.raises(
        UsageError, match="ant-dir commands no outcome of a step to follow; give way-points with --path"
    ):
        profile_course(ant, "0:1, 3:2")
    with pytest.raises(UsageError, match="halfcheetah-vel does not move freely on the floor; give --profile"):
        path_course(HalfCheetahVel("native"), "1 0", 1.0)
    with pytest.raises(UsageError, match="'1' is not x y, as in 6 0, 6 6"):
        path_course(ant, "1, 2 2", 1.0)
    with pytest.raises(UsageError, match="names a point twice in a row, or begins with the start"):
        path_course(ant, "0 0, 2 2", 1.0)


def test_the_arm_follows_nothing():
    pytest.importorskip("metaworld")
    with pytest.raises(UsageError, match="its tasks are met with `ear adapt`"):
        profile_course(Reach("native"), "0:1, 3:2")
