"""Courses, splines and pursuit, for agents whose actions are the first numbers of their codes."""

from __future__ import annotations

from dataclasses import replace

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from ear_jax.agents.tanh_gaussian import Gaussian
from ear_jax.config import Config
from ear_jax.embeddings.codes import fibonacci_sphere
from ear_jax.embeddings.course import PACE, course_of, path_course, profile_course
from ear_jax.embeddings.follow import SplineSearch, follow_course, look_up, ring_of, search_spline, spline
from ear_jax.embeddings.pursuit import LEAD, Pursuit
from ear_jax.embeddings.survey import Survey
from ear_jax.envs.ant_dir import AntDir
from ear_jax.envs.halfcheetah_vel import HalfCheetahVel
from ear_jax.envs.reach import Reach
from ear_jax.errors import UsageError
from ear_jax.physics import Physics
from ear_jax.runs.trained import Trained
from ear_jax.runs.training import Program
from tests.helpers.documented import check_keys
from tests.helpers.obedient import CODES, obedient
from tests.helpers.probe import TABLE, Bandit


class Puck(Bandit):
    """Never ends; its velocity on the floor is said to be its action, at once."""

    commanded, plane = "velocity_x", ("velocity_x", "velocity_y")

    def load(self):
        return mujoco.MjModel.from_xml_string(TABLE)

    def initial(self, key):
        return Physics(jnp.zeros(2), jnp.zeros(2), jnp.zeros(2))

    def observe(self, physics):
        return jnp.ones(1) + 0 * physics.qpos[:1]

    def outcome(self, motion):
        return {"velocity_x": motion.action[0], "velocity_y": motion.action[1]}

    def reward(self, outcome, task):
        return outcome["velocity_x"]

    def terminated(self, physics):
        return jnp.zeros((), bool)


@pytest.fixture(scope="module")
def ant() -> AntDir:
    return AntDir("native")


def test_a_spline_passes_its_knots_and_stays_on_the_sphere():
    codes = spline(np.eye(3), 9)
    np.testing.assert_allclose(codes[::4], np.eye(3), atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(codes, axis=1), 1, atol=1e-6)
    np.testing.assert_allclose(codes[2], [np.sqrt(0.5), np.sqrt(0.5), 0], atol=1e-6)
    np.testing.assert_allclose(spline(np.stack([np.eye(3)] * 2), 9), [codes, codes])


def test_the_search_finds_the_optimum():
    """The robot does the first number of its code; wanted is a line from −0.5 to 0.5."""
    wanted = np.linspace(-0.5, 0.5, 200)

    def play(codes, index):
        return {"costs": ((codes[..., 0] - wanted) ** 2).mean(axis=-1, keepdims=True)}

    begin, search = np.tile([0.0, 0.0, 1.0], (2, 5, 1)), SplineSearch(epochs=20, candidates=48)
    knots, costs = search_spline(play, begin, 200, search, 0)
    np.testing.assert_allclose(knots[..., 0], [np.linspace(-0.5, 0.5, 5)] * 2, atol=0.1)
    assert costs.shape == (2, 20)
    assert (costs[:, 0] > 10 * costs.min(axis=1)).all()
    assert costs.min(axis=1).max() < 0.002


@pytest.fixture(scope="module")
def puck() -> tuple[Trained, Survey]:
    """A robot whose velocity is the first two numbers of its code, and what a survey of its sphere found."""

    def distribution(policy, code, obs):
        return Gaussian(jnp.arctanh(jnp.clip(code[:2], -0.999, 0.999)), jnp.full(2, -9.0))

    family = Puck("native")
    agent = replace(obedient(CODES), distribution=distribution)
    program = Program(Config("puck"), family, family.training_tasks(), agent, None)  # type: ignore[arg-type]
    codes = fibonacci_sphere(2000)
    outcomes = {name: codes[None, :, column, None].repeat(4, 2) for column, name in enumerate(family.plane)}
    survey = Survey(codes, outcomes, np.full((1, 2000), 4, np.int32))
    return Trained("puck", program, jnp.zeros((1, 1)), 0), survey


def test_way_points_are_met_from_where_the_robot_is(puck):
    """It turns at once: it cuts corners only by what it covers in `LEAD`. Played again, its LTEs do the same."""
    trained, survey = puck
    course = course_of(trained.program.family, None, "2 0, 2 2, 0 2, 0 0", survey)
    assert course.speed == pytest.approx(PACE * np.sqrt(0.75), abs=0.01)  # half of a sphere lies below that radius
    document, trajectories = follow_course(trained, survey, course, SplineSearch(), 2, 0)
    check_keys("following", document)
    way = document["seeds"][0]["ways"]["pursuit"]
    cut = LEAD * course.speed
    assert cut / 2 < way["error"] < 1.2 * cut
    assert max(way["aside"]) < cut
    np.testing.assert_allclose(np.array(way["ltes"])[0, :2], [course.speed, 0], atol=0.05)
    moved = np.cumsum(np.array(way["ltes"])[:, :2], axis=0) * trained.program.family.dt
    np.testing.assert_allclose(way["followed"], moved, atol=0.01)
    assert document["env_steps"] == 0
    assert set(trajectories) == {"look-up", "pursuit"}
    assert len(trajectories["pursuit"].qpos) == len(way["followed"]) + 1 < len(course.wanted)
    np.testing.assert_allclose(way["followed"][-1], [0, 0], atol=cut)


def test_pursuit_turns_back_to_the_path_and_stays_at_its_end(puck):
    trained, survey = puck
    course = course_of(trained.program.family, None, "2 0, 2 2", survey)
    chase = Pursuit(trained.program.agent, course, jnp.asarray(ring_of(survey, 0, course)), 0.05)
    beside = chase.direction(replace(chase.begin(), place=jnp.array([0.5, 0.4])))
    assert beside[0] > 0 > beside[1]
    drifting = chase.direction(replace(chase.begin(), velocity=jnp.array([course.speed, 0.3])))
    assert drifting[1] < 0
    passed = replace(chase.begin(), place=jnp.array([2.0, 2.5]), leg=jnp.int32(1))
    assert chase.direction(passed)[1] < 0
    for angle in np.linspace(0, 6, 7):
        code = chase.code(jnp.array([np.cos(angle), np.sin(angle)]))
        np.testing.assert_allclose(code[:2], course.speed * np.array([np.cos(angle), np.sin(angle)]), atol=0.06)


def test_a_look_up_meets_what_is_wanted():
    codes = fibonacci_sphere(2000)
    survey = Survey(codes, {"action": codes[None, :, :1].repeat(4, 2)}, np.full((1, 2000), 4, np.int32))
    course = profile_course(Bandit("native"), "0:-0.5, 1:0.5, 2:0")
    found = look_up(survey, 0, course, len(course.wanted))
    np.testing.assert_allclose(found[:, 0], course.wanted[:, 0], atol=0.06)


def test_the_error_of_a_profile_leaves_out_the_first_second():
    course = profile_course(HalfCheetahVel("native"), "0:1, 3:4")
    wanted = 1 + 0.05 * np.arange(1, 61)
    np.testing.assert_allclose(course.wanted[:, 0], wanted)
    off = jnp.where(jnp.arange(60) < 20, 9.0, wanted + 0.3)
    error, cost, steps = course.error({"velocity": off}, jnp.ones(60, bool), 0.05)
    assert float(error) == pytest.approx(0.3, abs=1e-5)
    assert float(cost) > 1
    assert steps == 60


def test_way_points_count_in_their_order(ant):
    """The robot runs 0.6 m beside two corners of a square; another one meets them in the wrong order."""
    course = path_course(ant, "2 0, 2 2, 0 2", 1.0)
    corners = np.array([[0, 0], [2, 0], [2, 2], [0, 2]], float)

    def error(corners: np.ndarray, part: int = 0) -> float:
        moments = np.linspace(0, len(corners) - 1, 121)
        places = np.stack([np.interp(moments, range(len(corners)), column) for column in corners.T], axis=1)
        velocity = np.diff(places, axis=0) / 0.05
        outcome = {name: jnp.asarray(column, jnp.float32) for name, column in zip(ant.plane, velocity.T, strict=True)}
        return float(course.error(outcome, jnp.ones(120, bool), 0.05)[part])

    assert error(corners) == pytest.approx(0, abs=0.06)
    assert error(corners - np.array([[0, 0], [0.6, 0], [0.6, 0], [0, 0]])) == pytest.approx(0.6, abs=0.06)
    assert error(corners[[0, 3, 2, 1]]) > 1.5
    bulging = np.insert(corners, 2, [2.7, 1], axis=0)
    assert error(bulging, 1) == pytest.approx(0.7, abs=0.06)
    assert error(bulging) == pytest.approx(0, abs=0.06)


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
