"""PPO's parts with known answers."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ear_jax.agents.tanh_gaussian import Gaussian
from ear_jax.learning.ppo import CLIP, Ppo, PpoLearner, followed
from ear_jax.learning.value import make_value
from ear_jax.runs.trained import policy_of
from tests.helpers.teachable import on_clock


@pytest.fixture(scope="module")
def toy():
    return on_clock()


def learner_of(toy, **settings) -> PpoLearner:
    program = toy.program
    return PpoLearner(program.agent, program.family, program.tasks.params, Ppo(**settings))


def test_the_loss_is_the_advantage_times_a_ratio_that_is_clipped_where_it_gains(toy):
    learner = learner_of(toy, noise=1.0)
    old = Gaussian(jnp.zeros(1), jnp.zeros(1))
    loss, divergence = learner.surrogate(old, old, jnp.array([0.7]), jnp.float32(2.0))
    np.testing.assert_allclose([loss, divergence], [-2.0, 0.0], atol=1e-6)
    new = Gaussian(jnp.ones(1), jnp.zeros(1))  # the ratio at 1 is exp(1/2)
    loss, divergence = learner.surrogate(new, old, jnp.ones(1), jnp.float32(2.0))
    np.testing.assert_allclose([loss, divergence], [-2 * (1 + CLIP), 0.5], rtol=1e-6)
    loss, _ = learner.surrogate(new, old, jnp.ones(1), jnp.float32(-2.0))
    np.testing.assert_allclose(loss, 2 * np.exp(0.5), rtol=1e-6)


def test_noise_is_a_multiple_of_the_policys_but_never_less_than_the_least(toy):
    narrowed = learner_of(toy, noise=0.5, least_noise=0.1).narrowed(
        Gaussian(jnp.zeros(2), jnp.log(jnp.array([1.0, 0.01])))
    )
    np.testing.assert_allclose(jnp.exp(narrowed.log_std), [0.5, 0.1], rtol=1e-6)


def test_the_step_size_follows_the_divergence():
    lr, wanted = jnp.float32(3e-4), jnp.float32(0.01)
    found = [followed(lr, jnp.float32(moved), wanted) for moved in (0.02, 0.01, 0.005)]
    np.testing.assert_allclose(found, [2e-4, 3e-4, 4.5e-4], rtol=1e-6)
    assert followed(jnp.float32(1e-3), jnp.float32(0), wanted) == jnp.float32(1e-3)


@pytest.mark.parametrize(("discount", "left"), [(1.0, [2, 1, 0]), (0.5, [1.5, 1, 0])])
def test_a_value_is_the_mean_reward_to_come_times_the_discounts_left(discount, left):
    value = make_value(3, 2, 2, discount)
    np.testing.assert_allclose([value.horizon(jnp.int32(time)) for time in range(3)], left)
    params = value.init(jax.random.key(0))
    assert value(params, jnp.ones(3), jnp.int32(1), jnp.int32(2)) == 0, "nothing comes after the end"


def test_without_a_divergence_only_the_value_learns_and_codes_never_do(toy):
    learner, policy = learner_of(toy, episodes=4, batch=40), policy_of(toy, 0)
    state = learner.init(policy, jax.random.key(0))
    improve = jax.jit(learner.improve)
    warm, metrics = improve(state, jnp.float32(0), jax.random.key(1))
    jax.tree.map(np.testing.assert_array_equal, warm.policy, policy)
    assert metrics["lr"] == 0
    assert warm.lr == state.lr
    assert not np.array_equal(jax.tree.leaves(warm.value)[0], jax.tree.leaves(state.value)[0])
    moved, metrics = improve(warm, jnp.float32(0.01), jax.random.key(2))
    assert metrics["divergence"] > 0
    assert metrics["returns"].shape == (2,)
    assert improve._cache_size() == 1, "the divergence is an argument"
    codes = toy.program.agent.codes
    np.testing.assert_array_equal(codes(moved.policy), codes(policy))


def test_targets_are_returns_where_lambda_is_one(toy):
    learner = learner_of(toy, episodes=1, discount=1.0, gae_lambda=1.0, noise=0.0, least_noise=1e-6)
    policy = policy_of(toy, 0)
    state = learner.init(policy, jax.random.key(0))
    _, lesson, returns = learner.play(state, toy.program.agent.codes(policy), jax.random.key(0))
    np.testing.assert_allclose(returns, [-16, -16], atol=1e-2)
    np.testing.assert_allclose(lesson.target[0, :, 0], returns, atol=1e-4)
    np.testing.assert_allclose(lesson.advantage.mean(axis=(0, 2)), 0, atol=1e-5)
    np.testing.assert_allclose(lesson.advantage.std(axis=(0, 2)), 1, rtol=1e-3)
