"""Schedules of LTEs and what they teach, for an agent whose action is at first the first number of its code."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ear_jax.agents.networks import mlp
from ear_jax.agents.tanh_gaussian import Gaussian
from ear_jax.config import Config, NetworkConfig
from ear_jax.embeddings import schedule
from ear_jax.embeddings.refine import Refinement, refine
from ear_jax.embeddings.schedule import ScheduleSearch, choose, in_time, play_schedules, pushed
from ear_jax.embeddings.teach import Teaching, difference
from ear_jax.errors import UsageError
from ear_jax.runs.trained import Trained, policy_of
from ear_jax.runs.training import Program
from tests.helpers.obedient import CODES, obedient
from tests.helpers.probe import Clock

SMALL = Refinement(
    1, ScheduleSearch(epochs=10, starts=1, push=0.0), Teaching(passes=2, episodes=2, updates=300, batch=64, lr=3e-3)
)


def teachable(sphere: bool = True):
    """Returns an obedient agent with a network, at first of zeros, that is added to what it does."""
    network, base = mlp(4, (32,), 1, NetworkConfig(initialiser="fan_in")), obedient(CODES, sphere)

    def init(key):
        params = network.init(key)
        params["params"]["Dense_1"] = jax.tree.map(jnp.zeros_like, params["params"]["Dense_1"])
        return params

    def distribution(policy, code, obs):
        plain = base.distribution(policy, code, obs)
        return Gaussian(plain.mean + network.apply(policy, jnp.concatenate([obs, code])), plain.log_std)

    return dataclasses.replace(base, init_policy=init, distribution=distribution)


def make_toy(path, sphere: bool = True) -> Trained:
    family, agent = Clock("native"), teachable(sphere)
    program = Program(Config("clock"), family, family.training_tasks(), agent, None)  # type: ignore[arg-type]
    return Trained("toy", program, jax.vmap(agent.init_policy)(jax.random.split(jax.random.key(0), 1)), 0, path)


@pytest.fixture
def toy(tmp_path) -> Trained:
    return make_toy(tmp_path)


def test_pieces_begin_at_their_shares_of_an_episode():
    pieces = in_time(jnp.arange(20.0).reshape(2, 10, 1), 200)
    assert pieces.shape == (200, 2, 1)
    assert np.flatnonzero(np.diff(pieces[:, 0, 0])).tolist() == [4, 9, 14, 19, 29, 39, 59, 79, 119]
    assert pieces[-1, :, 0].tolist() == [9, 19]


def test_a_push_is_added_to_the_mean_before_tanh(toy):
    agent, policy = toy.program.agent, policy_of(toy, 0)
    piece, obs = jnp.append(CODES[0], 0.2), jnp.zeros(1)
    plain, with_push = agent.distribution(policy, CODES[0], obs), pushed(agent, policy, piece, obs)
    np.testing.assert_allclose(with_push.mean, plain.mean + 0.2, rtol=1e-6)
    np.testing.assert_array_equal(with_push.log_std, plain.log_std)


def test_candidates_are_on_the_sphere_and_the_best_of_them_are_kept(toy):
    agent = toy.program.agent
    state = schedule.init(CODES, 1, ScheduleSearch())
    candidates = schedule.ask(state, jax.random.key(0), 6, agent)
    np.testing.assert_allclose(jnp.linalg.norm(candidates[..., :3], axis=-1), 1, rtol=1e-5)
    np.testing.assert_allclose(candidates[:, 0], state.pieces, atol=1e-6)
    assert not candidates[:, :, -1, 3].any(), "the last piece has no push"
    assert candidates[:, 1:, 0, 3].all()
    returns = jnp.arange(12.0).reshape(2, 6)
    best = schedule.tell(state, candidates, returns, 1, agent)
    np.testing.assert_allclose(best.pieces, candidates[:, 5], atol=1e-6)
    np.testing.assert_allclose(best.sigma, 0.3 * state.sigma, atol=1e-6)


def test_a_schedule_is_taken_only_where_it_returns_more(toy):
    """Under its own code the first task's action is right for 4 steps of 20 and off by 1 for 16."""
    own = schedule.constant(CODES, 1)
    right = own.at[0, 6:].set(own[1, 0]).at[1, :6].set(own[0, 0])
    policy, key = policy_of(toy, 0), jax.random.key(0)
    returns = play_schedules(toy.program, policy, jnp.stack([own, right], axis=1), key, 2)
    np.testing.assert_allclose(returns, [[-16, 0], [-16, -20]], atol=1e-4)
    chosen = choose(toy.program, policy, right, key, 2)
    np.testing.assert_array_equal(chosen[0], right[0])
    np.testing.assert_array_equal(chosen[1], own[1])


def test_a_policy_learns_what_its_schedules_do_and_keeps_its_ltes(toy):
    refined, document = refine(toy, SMALL, episodes=1)
    (seed,) = document["seeds"]
    (first,) = seed["rounds"]
    assert seed["mean_return"] == pytest.approx(-16, abs=1e-3)
    assert first["scheduled"] > -0.8
    assert first["refined"] > -2.5, "the step at 0.2 is smooth for a network"
    assert document["env_steps"] == refined.about["refined"]["env_steps"] == 20 * 2 * (10 * 48 + 2 * 2 * 2 + 2)
    agent, now, before = toy.program.agent, policy_of(refined, 0), policy_of(toy, 0)
    np.testing.assert_array_equal(agent.codes(now), agent.codes(before))
    pole, late = jnp.array([0.0, -1.0, 0.0]), jnp.array([0.6])
    assert difference(agent.distribution(now, pole, late), agent.distribution(before, pole, late)) < 1.0


@pytest.mark.slow
def test_equal_seeds_refine_to_equal_bits_and_costs_add_up(toy):
    quick = Refinement(1, ScheduleSearch(2, 16, 1), Teaching(1, 1, 3, 8))
    (one, document), (two, _) = (refine(toy, quick, 1, seed=3) for _ in range(2))
    assert one.fingerprint == two.fingerprint != toy.fingerprint
    again = refine(one, quick, 1)[0].about["refined"]
    assert again["env_steps"] == 2 * document["env_steps"]
    assert (again["rounds"], again["from"]) == (2, one.fingerprint)


def test_an_agent_without_a_sphere_is_refused(tmp_path):
    with pytest.raises(UsageError, match="sphere"):
        refine(make_toy(tmp_path, sphere=False), SMALL)
