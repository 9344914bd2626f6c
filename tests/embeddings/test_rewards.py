"""LTEs for rewards, for an agent whose action is the first number of its code: the best code is known."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ear_jax.config import Config
from ear_jax.embeddings import rewards, survey
from ear_jax.embeddings.imagine import Imagined, best_imagined
from ear_jax.embeddings.kept import read_kept, write_kept
from ear_jax.embeddings.rewards import adapt_to_rewards
from ear_jax.embeddings.search import Search
from ear_jax.embeddings.survey import find_survey
from ear_jax.errors import RunError, UsageError
from ear_jax.learning.measure import MeasureConfig, late_in_episode, learn_measure, make_measure, partition
from ear_jax.learning.replay import Experience
from ear_jax.runs.trained import Trained
from ear_jax.runs.training import Program
from tests.helpers.documented import check_keys
from tests.helpers.obedient import CODES, obedient
from tests.helpers.probe import Slider

PLACES = 500


@pytest.fixture
def toy(tmp_path) -> Trained:
    family = Slider("native")
    program = Program(Config("slider"), family, family.training_tasks(), obedient(CODES), None)  # type: ignore[arg-type]
    return Trained("toy", program, jnp.zeros((1, 1)), 0, tmp_path)


def test_the_best_code_of_a_reward_is_found_in_every_way(toy, monkeypatch):
    """A return sums four steps: −4 (a − 0.3)² is best at a = 0.3, the window anywhere in it, and a² at both ends."""

    def squared(outcome):
        return outcome["action"] ** 2

    asked = ("-(action - 0.3)**2", "1 if -0.8 < action < -0.6 else 0", squared)
    document = adapt_to_rewards(toy, asked, Search(epochs=4, sigma=0.3), 1, places=PLACES)
    check_keys("adaptation to rewards", document)
    near, window, ends = document["tasks"]
    for way in ("map", "search"):
        assert near["answers"][way]["lte"][0] == pytest.approx(0.3, abs=0.05)
        assert near["answers"][way]["reevaluated"] == pytest.approx(0, abs=0.01)
        assert window["answers"][way]["reevaluated"] == pytest.approx(4)
        assert -0.8 < window["answers"][way]["outcome"]["action"] < -0.6
        assert abs(ends["answers"][way]["lte"][0]) > 0.9
    assert window["answers"]["map"]["predicted"] == pytest.approx(4, abs=0.1)
    assert (near["name"], ends["name"], window["best"] in window["answers"]) == (asked[0], "squared", True)
    assert len(near["epochs"]) == 4
    assert document["costs"]["map"]["env_steps"] == PLACES * 4
    assert document["costs"]["search"]["env_steps"] == 3 * 4 * 90 * 4

    monkeypatch.setattr(survey, "play_survey", lambda *_: pytest.fail("the sphere was surveyed again"))
    again = adapt_to_rewards(toy, ["-(action + 0.5)**2"], None, 1, places=PLACES)
    assert again["costs"] == {"map": {"env_steps": 0, "seconds": again["costs"]["map"]["seconds"]}}
    assert again["tasks"][0]["lte"][0] == pytest.approx(-0.5, abs=0.05)


def test_a_survey_that_is_damaged_or_anothers_is_played_again(toy, capsys):
    kept = find_survey(toy, PLACES, 0)[0]
    (path,) = toy.directory.glob("survey*.safetensors")
    whole = path.read_bytes()
    for content in (whole[:-1], whole[:-1] + bytes([whole[-1] ^ 1])):
        path.write_bytes(content)
        again, env_steps = find_survey(toy, PLACES, 0)
        assert env_steps == PLACES * 4
        np.testing.assert_array_equal(again.outcomes["action"], kept.outcomes["action"])
    path.write_bytes(whole)
    assert find_survey(toy, PLACES, 0)[1] == 0
    other = Trained("other", toy.program, toy.policies + 1, 0, toy.directory)
    assert find_survey(other, PLACES, 0)[1] == PLACES * 4
    assert capsys.readouterr().err.count("the sphere is surveyed again") == 3


@pytest.mark.parametrize(
    ("kind", "shape", "complaint"),
    [("ear_jax survey 0", (3,), "is not of the format ear_jax survey 0"), ("kept", (4,), "is of another family")],
)
def test_what_was_kept_for_something_else_is_named(toy, kind, shape, complaint):
    path = toy.directory / "kept.safetensors"
    write_kept(path, {"numbers": np.zeros(3, np.float32)}, toy, "kept")
    assert read_kept(path, {"numbers": (3,)}, toy, "kept")["numbers"].shape == (3,)
    with pytest.raises(RunError, match=complaint):
        read_kept(path, {"numbers": shape}, toy, kind)


def test_a_reward_that_is_not_finite_is_one_line(toy):
    with pytest.raises(UsageError, match=r"reward 'sqrt\(action\)' is not a finite number at action -0\.\d+, which"):
        adapt_to_rewards(toy, ["sqrt(action)"], None, 1, places=PLACES)


def test_without_a_sphere_a_reward_is_searched_for(toy):
    free = Program(toy.program.config, toy.program.family, toy.program.tasks, obedient(CODES, sphere=False), None)
    trained = Trained("free", free, toy.policies, 0, toy.directory)
    (task,) = adapt_to_rewards(trained, ["-(action - 0.3)**2"], Search(epochs=4, sigma=0.3), 1)["tasks"]
    assert list(task["answers"]) == ["search"]
    with pytest.raises(UsageError, match=r"reward 'log\(action - 2\)' is not a finite number"):
        adapt_to_rewards(trained, ["log(action - 2)"], Search(epochs=1), 1)
    with pytest.raises(UsageError, match="has no sphere of LTEs to map"):
        adapt_to_rewards(trained, ["action"], None, 1)


@pytest.mark.slow
def test_a_measure_learns_the_outcomes_of_actions_that_others_took():
    """Transitions are of random actions; under a code the outcome is for ever its first number."""
    agent, rng = obedient(CODES), np.random.default_rng(0)
    action, obs = rng.uniform(-1, 1, (2000, 1)).astype(np.float32), np.ones((2000, 1), np.float32)
    items = jax.tree.map(jnp.asarray, Experience(obs, action, obs, {"action": action[:, 0]}, np.zeros(2000, bool)))
    cell = partition(action, 16)
    measure = make_measure(agent, 1, 1, MeasureConfig(cells=16, updates=1500, batch_size=256, width=32, discount=0.5))
    params, losses = jax.jit(lambda: learn_measure(measure, jnp.zeros(1), items, jnp.array(cell), jax.random.key(0)))()
    assert losses[-50:].mean() < losses[:50].mean()
    codes = np.array([[x, np.sqrt(1 - x**2), 0] for x in (-0.7, 0.0, 0.6)], np.float32)
    masses = jax.vmap(lambda code: measure.of_start(params, jnp.zeros(1), code, obs[0]))(codes)
    np.testing.assert_allclose(masses.sum(axis=1), 1, rtol=1e-4)
    imagined = Imagined(codes, np.asarray(masses)[None, :, :-1], {"action": action.T}, cell[None])
    np.testing.assert_allclose(imagined.means(action.T)[0], codes[:, 0], atol=0.1)
    best, predicted = best_imagined(imagined, lambda outcome: -jnp.abs(outcome["action"]), 4)
    np.testing.assert_allclose(best[0], codes[1])
    assert predicted[0] == pytest.approx(0, abs=0.6)


def test_an_episode_is_a_chain_of_jumps_until_a_failure():
    """It begins in cell 0, from there goes to cell 1, and from there stays or fails, as often."""
    measure = make_measure(obedient(CODES), 1, 1, MeasureConfig(cells=2, discount=0.5))
    first, later = jnp.array([[1.0, 0, 0]]), jnp.array([[0, 1.0, 0], [0, 1.0, 0], [0, 0.5, 0.5]])
    masses = late_in_episode(measure, first, later, jnp.array([0, 0, 1]), 6)
    np.testing.assert_allclose(masses, np.mean([[0, 1], [0, 0.5]], axis=0), atol=1e-6)


def test_cells_are_of_alike_outcomes():
    outcomes = np.repeat(np.array([[0.0, 0], [0, 5], [3, 0]]), 20, axis=0) + np.linspace(0, 0.1, 60)[:, None]
    cell = partition(outcomes, 3)
    assert {tuple(cell[first : first + 20]) for first in (0, 20, 40)} == {(one,) * 20 for one in range(3)}


def test_rewards_are_of_agents_with_ltes(toy):
    tuned = rewards.replace(toy.program.agent, tuned=True)
    program = rewards.replace(toy.program, agent=tuned)
    with pytest.raises(UsageError, match="has no LTEs; --reward finds LTEs"):
        adapt_to_rewards(rewards.replace(toy, program=program), ["action"], Search(), 1)
