"""The SAC objectives against NumPy, by hand."""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ear_jax.agents import critic as critics
from ear_jax.agents.critic import aggregate_q, task_critic
from ear_jax.agents.tanh_gaussian import Gaussian, gaussian, sample, squash
from ear_jax.config import Config, NetworkConfig
from ear_jax.learning import losses
from ear_jax.learning.batch import Batch

CRITIC = task_critic(1, 1, 2, Config("bandit", network=NetworkConfig(8)))


def batch(**changes) -> Batch:
    fields = {
        "obs": jnp.zeros((3, 1)),
        "action": jnp.zeros((3, 1)),
        "next_obs": jnp.zeros((3, 1)),
        "reward": jnp.array([1.0, 2.0, 3.0]),
        "outcome": {},
        "terminated": jnp.array([False, True, False]),
        "task": jnp.array([0, 0, 1]),
    }
    return Batch(**{**fields, **changes})


def test_target_stops_only_at_termination():
    next_value = jnp.array([8.0, 10.0, 7.0])
    log_prob = jnp.array([-1.0, 5.0, 2.0])
    temperature = jnp.array([0.5, 0.5, 0.25])
    target = losses.critic_targets(
        CRITIC, next_value[None], batch(), log_prob, temperature, discount=0.9, pessimism=1.0
    )
    np.testing.assert_allclose(target, [1 + 0.9 * (8 + 0.5), 2.0, 3 + 0.9 * (7 - 0.5)], rtol=1e-6)


@pytest.mark.parametrize(("pessimism", "expected"), [(1.0, [1.0, 0.0]), (0.0, [2.0, 1.0]), (0.5, [1.5, 0.5])])
def test_aggregated_q_lies_between_the_lesser_critic_and_the_mean(pessimism, expected):
    values = jnp.array([[1.0, 2.0], [3.0, 0.0]])
    np.testing.assert_allclose(aggregate_q(values, pessimism), expected)


def test_critic_loss_is_half_the_squared_error_of_each_critic():
    values, target = jnp.array([[1.0, 2.0], [3.0, 5.0]]), jnp.array([0.0, 4.0])
    each = losses.critic_losses(CRITIC, values, target)
    assert losses.critic_loss(each) == pytest.approx(0.5 * (1 + 4) / 2 + 0.5 * (9 + 1) / 2)


def test_actor_loss():
    value, log_prob = jnp.array([1.0, 0.0]), jnp.array([-1.0, 2.0])
    loss = losses.actor_loss(value, log_prob, jnp.array([0.1, 0.2]))
    assert loss == pytest.approx(((-0.1 - 1.0) + (0.4 - 0.0)) / 2)


def test_temperature_moves_towards_the_target_entropy():
    too_certain, too_random = jnp.full(4, 3.0), jnp.full(4, -9.0)
    grad = jax.grad(losses.temperature_loss)
    assert grad(jnp.float32(0.3), too_certain, -6.0) == pytest.approx(-(3.0 - 6.0))
    assert grad(jnp.float32(0.3), too_random, -6.0) == pytest.approx(-(-9.0 - 6.0))
    # log π = 3 is entropy −3, above the target of −6: α must fall, and it does, as its gradient is positive.
    assert grad(jnp.float32(0.3), too_certain, -6.0) > 0


def test_sample_log_density_equals_the_change_of_variables():
    rng = np.random.default_rng(0)
    mean, log_std, noise = rng.normal(size=(3, 5)).astype(np.float64)
    action, log_prob = sample(Gaussian(jnp.array(mean), jnp.array(log_std)), jnp.array(noise))
    raw = mean + np.exp(log_std) * noise
    normal = np.exp(-0.5 * noise**2) / (np.exp(log_std) * np.sqrt(2 * np.pi))
    np.testing.assert_allclose(action, np.tanh(raw), rtol=1e-5)
    assert log_prob == pytest.approx(np.log(normal / (1 - np.tanh(raw) ** 2)).sum(), rel=1e-4)


def test_sample_is_finite_where_tanh_saturates():
    action, log_prob = sample(Gaussian(jnp.array([40.0, -40.0]), jnp.zeros(2)), jnp.zeros(2))
    assert jnp.isfinite(log_prob)
    np.testing.assert_allclose(action, [1, -1])


def test_without_noise_the_action_is_tanh_of_the_mean():
    distribution = gaussian(jnp.array([0.3, -2.0, 9.0, -99.0]))
    np.testing.assert_allclose(squash(distribution, jnp.zeros(2)), np.tanh([0.3, -2.0]), rtol=1e-6)
    np.testing.assert_allclose(distribution.log_std, [2.0, -20.0])


@pytest.mark.parametrize(
    "network",
    [NetworkConfig(8, critic_layers=1), pytest.param(NetworkConfig(8, critic_blocks=1), marks=pytest.mark.slow)],
)
def test_a_row_of_weights_stands_for_the_one_hot_of_many_tasks(network, monkeypatch):
    """Predictions and gradients are those of the whole product but for rounding."""
    monkeypatch.setattr(critics, "FEW", 2)
    tasks, code, items = 3, 2, 6
    multiplied, by_row = (task_critic(4, 1, tasks + code, Config("bandit", network=network), n) for n in (0, tasks))
    shapes = jax.eval_shape(jax.vmap(multiplied.init), jax.eval_shape(lambda: jax.random.split(jax.random.key(0))))
    dice = np.random.default_rng(0)
    params = jax.tree.map(lambda leaf: dice.normal(size=leaf.shape).astype(np.float32), shapes)
    obs, action, codes = (dice.normal(size=(items, size)).astype(np.float32) for size in (4, 1, code))
    task = np.hstack([np.eye(tasks, dtype=np.float32)[[0, 2, 1, 1, 0, 2]], codes])

    def loss(critic, params, action, task):
        return jnp.sum(losses.predictions(params, critic, obs, action, task) ** 2)

    def value_and_grads(critic):
        value, (*grads, by_task) = jax.value_and_grad(partial(loss, critic), (0, 1, 2))(params, action, task)
        return value, grads, by_task[:, tasks:]  # nobody needs the gradient by a one-hot

    one, other = jax.jit(lambda: tuple(map(value_and_grads, (multiplied, by_row))))()
    jax.tree.map(lambda mine, theirs: np.testing.assert_allclose(mine, theirs, rtol=1e-4, atol=1e-5), one, other)
