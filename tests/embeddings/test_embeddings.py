"""Blends, searches and maps of codes, for an agent whose action is the first number of its code."""

from __future__ import annotations

import dataclasses
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ear_jax.agents.networks import unit_vector
from ear_jax.cli.adapt import _check_save as check_save
from ear_jax.cli.interpolate import _at_betas as at_betas
from ear_jax.config import Config
from ear_jax.embeddings import adapt as adaptation
from ear_jax.embeddings import cem
from ear_jax.embeddings.adapt import adapt
from ear_jax.embeddings.codes import blend, fibonacci_sphere, slerp, spread_codes
from ear_jax.embeddings.evaluate import evaluate, evaluate_code
from ear_jax.embeddings.interpolate import BETAS, End, adjacent_pairs, interpolate, play_blends, trained_ends
from ear_jax.embeddings.interpolate import _check_reach as check_reach
from ear_jax.embeddings.map import LteMap, check_sphere, codes_for_targets, describe, play_maps
from ear_jax.embeddings.search import Search
from ear_jax.envs.ant_dir import AntDir
from ear_jax.errors import UsageError
from ear_jax.methods import Sizes, make_agent
from ear_jax.presets import preset_config
from ear_jax.runs.trained import Trained, load
from ear_jax.runs.training import Program
from ear_jax.tasks import task_set
from tests.helpers.documented import check_keys
from tests.helpers.obedient import CODES, obedient
from tests.helpers.probe import Bandit, Slider


@pytest.fixture(scope="module")
def toy() -> Trained:
    family = Bandit("native")
    program = Program(Config("bandit"), family, family.training_tasks(), obedient(CODES), None)  # type: ignore[arg-type]
    return Trained("toy", program, jnp.zeros((1, 1)), 0)


def test_blend_and_slerp_agree_at_the_ends_and_stay_on_the_sphere():
    rng = np.random.default_rng(0)
    for _ in range(20):
        first, second = (unit_vector(jnp.array(vector)) for vector in rng.normal(size=(2, 3)))
        for beta, end in ((1.0, first), (0.0, second)):
            np.testing.assert_allclose(blend(first, second, beta, unit_vector), end, atol=1e-6)
            np.testing.assert_allclose(slerp(first, second, beta), end, atol=1e-6)
        np.testing.assert_allclose(blend(first, second, 0.5, unit_vector), slerp(first, second, 0.5), atol=1e-5)
        for beta in (-0.8, 0.3, 1.8):
            assert np.linalg.norm(slerp(first, second, beta)) == pytest.approx(1, abs=1e-5)
            assert np.linalg.norm(blend(first, second, beta, unit_vector)) == pytest.approx(1, abs=1e-5)


def test_slerp_of_a_code_with_itself_is_that_code():
    code = unit_vector(jnp.array([1.0, 2.0, 3.0]))
    np.testing.assert_allclose(slerp(code, code, 0.3), code, atol=1e-6)


def test_slerp_through_opposite_codes_takes_a_great_circle():
    code = unit_vector(jnp.array([1.0, 2.0, 3.0]))
    halfway = slerp(code, -code, 0.5)
    assert np.linalg.norm(halfway) == pytest.approx(1, abs=1e-5)
    assert float(halfway @ code) == pytest.approx(0, abs=1e-5)


def test_slerp_moves_at_constant_angle():
    angles = [
        np.degrees(np.arccos(np.dot(slerp(jnp.eye(3)[0], jnp.eye(3)[1], beta), np.eye(3)[1])))
        for beta in (0.25, 0.5, 0.75)
    ]
    np.testing.assert_allclose(angles, [22.5, 45, 67.5], atol=1e-3)


def test_sphere_is_covered_evenly():
    points = fibonacci_sphere(500)
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), 1, rtol=1e-5)
    np.testing.assert_allclose(points.mean(0), 0, atol=1e-2)
    distance = np.arccos(np.clip(points @ points.T, -1, 1)) + 9 * np.eye(500)
    assert distance.min() > 0.06, "radians; 500 even points are about 0.15 apart"
    circle = spread_codes(8, 2)
    np.testing.assert_allclose((circle * np.roll(circle, 1, axis=0)).sum(axis=1), np.cos(np.pi / 4), atol=1e-6)


def test_beta_search_finds_the_closed_form(toy):
    """The blend's first number is b/√(b² + 3), b = 1 − 2β: 0.2 asks for b = 0.2 √3 / √0.96."""
    document = interpolate(toy, [tuple(trained_ends(toy))], target=0.2, episodes=1, seed=0)
    check_keys("interpolation", document)
    (found,) = document["pairs"]
    exact = (1 - 0.2 * np.sqrt(3) / np.sqrt(0.96)) / 2
    assert found["beta"] == pytest.approx(exact, abs=0.006)
    assert found["outcome"] == pytest.approx(0.2, abs=0.005)
    assert found["one_to_one_outcome"] == pytest.approx(0, abs=1e-5)
    assert found["one_to_one"]
    assert found["mid_task"]
    assert found["fresh_outcome"] == pytest.approx(found["outcome"], abs=1e-5)
    assert found["fresh"]


def test_extrapolation_follows_the_formula(toy):
    betas = (1.8, 1.0, 0.25, 0.0, -0.8)
    b = 1 - 2 * np.array(betas)
    achieved = play_blends(toy, [tuple(trained_ends(toy))], betas, episodes=1, seed=0)
    np.testing.assert_allclose(achieved[0, 0], b / np.sqrt(b**2 + 3), atol=1e-4)


def test_a_pair_without_a_value_between_fails_both_measures(toy):
    stuck = Program(toy.program.config, toy.program.family, toy.program.tasks, obedient(CODES[:1].repeat(2, 0)), None)
    trained = Trained("stuck", stuck, jnp.zeros((1, 1)), 0)
    found = interpolate(trained, [tuple(trained_ends(trained))], None, 1, 0)
    assert found["mid_task"] == {"success": 0, "total": 1}
    assert found["one_to_one"] == {"success": 0, "total": 1}
    assert found["fresh"] == {"success": 0, "total": 1}


def test_neighbours_of_directions_wrap():
    family = AntDir("native")
    ends = [End(str(angle), angle, np.zeros((1, 3))) for angle in (90.0, 0.0, 270.0, 180.0)]
    found = [(one.target, other.target) for one, other in adjacent_pairs(ends, family)]
    assert found == [(0, 90), (90, 180), (180, 270), (270, 0)]
    twins = [End(str(place), 90.0, np.zeros((1, 3))) for place in range(2)]
    assert adjacent_pairs(twins, family) == [], "there is nothing between them"
    assert family.difference(350.0, 10.0) == -20
    assert family.difference(10.0, 350.0) == 20


def test_cem_finds_the_optimum(toy):
    tasks = task_set([toy.program.family.parse_task(text) for text in ("0.3", "-0.9")])
    unmapped = replace(toy, program=replace(toy.program, agent=replace(toy.program.agent, embed=None)))
    document = adapt(unmapped, tasks, Search(epochs=8, sigma=0.3), episodes=1, seed=0)
    for task, target in zip(document["tasks"], (0.3, -0.9), strict=True):
        assert task["lte"][0] == pytest.approx(target, abs=0.02)
        assert np.linalg.norm(task["lte"]) == pytest.approx(1, abs=1e-5)
        assert task["epochs"][-1]["reevaluated"] == pytest.approx(0, abs=1e-3)
        assert len(task["epochs"]) == 8
    assert document["env_steps"] == 2 * 8 * 90 * toy.program.family.episode_length


def test_cem_asks_the_elites_again_and_keeps_the_best():
    state = cem.init(jax.random.key(0), 6, 3, unit_vector)
    candidates = cem.ask(state, jax.random.key(1), 14, 0.5, unit_vector)
    assert candidates.shape == (90, 3)
    np.testing.assert_array_equal(candidates[:6], state.elites)
    np.testing.assert_allclose(np.linalg.norm(candidates, axis=1), 1, rtol=1e-5)
    returns = jnp.arange(90.0)
    np.testing.assert_array_equal(cem.tell(state, candidates, returns).elites, candidates[:-7:-1])


def test_failures_are_episodes_that_end_before_their_time(toy):
    """A bandit ends after its first step; the slider stays short of x = 2 for all four of its steps."""
    slider = Slider("native")
    whole = Program(Config("slider"), slider, slider.training_tasks(), obedient(CODES), None)  # type: ignore[arg-type]
    for trained, failures in ((toy, 3), (Trained("whole", whole, jnp.zeros((1, 1)), 0), 0)):
        document = evaluate(trained, episodes=3, seed=0)
        check_keys("evaluation", document)
        assert [task["failures"] for task in document["seeds"][0]["tasks"]] == [failures, failures]
        assert document["failed_tasks"] == {"failed": 2 * (failures > 0), "total": 2}


def test_a_map_and_an_lte_are_told_of(toy):
    check_keys("map", describe(toy, play_maps(toy, 20, 1, 0)))
    check_keys("evaluation of an LTE", evaluate_code(toy, np.eye(3)[:1], 1, 0))
    asked = SimpleNamespace(beta=(0.5,), episodes=1, seed=0, along="chord")
    check_keys("blends", at_betas(toy, [tuple(trained_ends(toy))], asked))


def test_what_is_asked_again_is_not_compiled_again(toy, monkeypatch):
    traced, reward = [], type(toy.program.family).reward

    def count(family, outcome, task):
        traced.append(family)
        return reward(family, outcome, task)

    monkeypatch.setattr(type(toy.program.family), "reward", count)
    for ask in (lambda seed: evaluate(toy, 2, seed), lambda seed: evaluate_code(toy, np.eye(3)[:1], 2, seed)):
        ask(0)
        before = len(traced)
        assert before > 0
        ask(1)
        assert len(traced) == before
        traced.clear()


def test_betas_are_the_papers():
    assert (BETAS[0], BETAS[49], BETAS[-1], len(BETAS)) == (0.01, 0.5, 0.99, 99)


def test_a_map_of_the_sphere_answers_without_search(toy):
    targets = (0.3, -0.7)
    tasks = task_set([toy.program.family.parse_task(str(target)) for target in targets])
    document = adapt(toy, tasks, None, episodes=1, seed=0)
    check_keys("adaptation", document)
    assert document["env_steps"] == 0
    for task, target in zip(document["tasks"], targets, strict=True):
        assert task["epochs"] == []
        assert task["zero_shot"]["lte"] == task["lte"]
        assert task["lte"][0] == pytest.approx(target, abs=0.03)
        assert task["zero_shot"]["error"] == pytest.approx(abs(task["lte"][0] - target), abs=1e-3)
        assert task["zero_shot"]["predicted"] == pytest.approx(target, abs=0.02)


def test_a_map_refuses_what_no_code_reaches(toy):
    with pytest.raises(UsageError, match=r"no LTE of this run comes near 5 1; they reach -1.00 to 1.00"):
        adapt(toy, task_set([toy.program.family.parse_task("5")]), None, episodes=1, seed=0)


def test_without_a_sphere_there_is_neither_an_arc_nor_a_map(toy):
    free = dataclasses.replace(toy.program, agent=dataclasses.replace(toy.program.agent, on_sphere=False))
    trained = dataclasses.replace(toy, program=free)
    pair = tuple(trained_ends(trained))
    assert play_blends(trained, [pair], (0.5,), 1, 0).shape == (1, 1, 1)
    with pytest.raises(UsageError, match="--along arc needs LTEs on a sphere"):
        play_blends(trained, [pair], (0.5,), 1, 0, along="arc")
    tasks = task_set([free.family.parse_task("0.3")])
    with pytest.raises(UsageError, match="has no sphere of LTEs to map"):
        adapt(trained, tasks, None, episodes=1, seed=0)
    (task,) = adapt(trained, tasks, Search(epochs=1), episodes=1, seed=0)["tasks"]
    assert task["zero_shot"] is None


def test_codes_lie_on_a_sphere_where_they_are_unit_vectors_and_stay_so():
    for name, preset, wanted in (
        ("ear", "fast", True),
        ("ear", "fast+no-norm", False),
        ("ear-rnn", "fast", True),
        ("onehot", "fast", True),
        ("onehot-blind", "fast", False),
        ("multihead", "fast", False),
        ("pearl", "fast", False),
        ("maml", "fast", False),
    ):
        network = preset_config("halfcheetah-vel", preset, name).network
        config = replace(preset_config("halfcheetah-vel", "fast", name), network=network)
        assert make_agent(Sizes(18 * network.history, 6, 10), config).on_sphere is wanted


def test_without_two_tasks_that_command_something_there_is_nothing_to_blend(toy):
    with pytest.raises(UsageError, match="toy has no two tasks with a target action"):
        play_blends(toy, [], (0.5,), 1, 0)


def test_a_sphere_of_another_size_is_not_drawn(toy):
    with pytest.raises(UsageError, match="this run's LTEs have 3 numbers; only those with 2 can be drawn"):
        check_sphere(toy, 2)


def test_a_target_that_no_blend_comes_near_is_refused(toy):
    with pytest.raises(UsageError, match=r"no blend of -0\.5 and 0\.5 comes near 9; they reach -?[\d.]+ to [\d.]+ 1"):
        check_reach(toy.program.family, tuple(trained_ends(toy)), np.array([-0.6, 0.1, 0.7]), 9.0)


def test_a_policy_that_tunes_itself_has_no_lte_to_save(toy):
    tuned = replace(toy, program=replace(toy.program, agent=replace(toy.program.agent, tuned=True)))
    with pytest.raises(UsageError, match="--save trot: ear has no LTEs to save"):
        check_save("trot", tuned)


def test_a_search_answers_what_the_map_does_not_reach(toy):
    """The best that a code can do for 5 is 1; the other task keeps its answer from the map."""
    tasks = task_set([toy.program.family.parse_task(text) for text in ("5", "0.3")])
    far, near = adapt(toy, tasks, Search(), episodes=1, seed=0)["tasks"]
    assert far["zero_shot"] is None
    assert far["lte"][0] == pytest.approx(1, abs=0.02)
    assert near["zero_shot"]["lte"][0] == pytest.approx(0.3, abs=0.03)


@pytest.mark.parametrize("target", [5.0, -99.0, 1.2])
def test_a_search_can_refuse_what_the_map_does_not_reach(toy, target, monkeypatch):
    monkeypatch.setattr(adaptation, "search_all", lambda *_: pytest.fail("it was searched for"))
    tasks = task_set([toy.program.family.parse_task(str(target))])
    with pytest.raises(UsageError, match=rf"comes near {target:g} 1; they reach -1\.00 to 1\.00"):
        adapt(toy, tasks, Search(), episodes=1, seed=0, within_reach=True)


def test_a_target_at_the_edge_of_the_map_is_searched_for(toy):
    tasks = task_set([toy.program.family.parse_task("1.05")])
    (task,) = adapt(toy, tasks, Search(epochs=2), episodes=1, seed=0, within_reach=True)["tasks"]
    assert task["lte"][0] > 0.9


def test_a_map_of_directions_wraps():
    """Codes whose direction is their longitude: 350° and 10° are neighbours of 0°."""
    codes = fibonacci_sphere(2000)
    longitude = np.degrees(np.arctan2(codes[:, 1], codes[:, 0])) % 360
    lte_map = LteMap(codes, longitude, {}, np.full(2000, 200))
    (code, predicted), (other, _) = codes_for_targets(lte_map, AntDir("native"), [0.0, 90.0])
    assert abs(np.degrees(np.arctan2(other[1], other[0])) - 90) < 3
    assert abs(np.degrees(np.arctan2(code[1], code[0]))) < 3
    assert abs(predicted) < 3
    assert abs(code[2]) < 0.9, "near the poles all directions meet, and none is kept"


def test_a_fingerprint_tells_policies_apart(toy):
    other = dataclasses.replace(toy, policies=toy.policies + 1)
    assert toy.fingerprint == dataclasses.replace(toy).fingerprint != other.fingerprint


@pytest.mark.parametrize(
    ("codes", "episodes", "complaint"),
    [
        (np.zeros(3), 1, r"codes must have shape \(1, 3\), one for each seed, but have \(3,\)"),
        (np.full((1, 3), np.nan), 1, "codes must be finite"),
        (np.ones((1, 3)), 0, "episodes 0 is too small; it must be at least 1"),
    ],
)
def test_codes_that_cannot_be_played_are_refused(codes, episodes, complaint):
    trained = load(Path("pretrained:hopper-vel"))
    with pytest.raises(UsageError, match=complaint):
        evaluate_code(trained, codes.tolist(), episodes, 0)
    with pytest.raises(UsageError, match="episodes 0 is too small"):
        evaluate(trained, 0, 0)
