"""The ingredients of a recipe that are off by default, each against its equation worked out by hand."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ear_jax.agents import categorical
from ear_jax.agents.critic import clipped_target, task_critic
from ear_jax.agents.networks import BATCH, batch_normed, is_kernel, residual
from ear_jax.config import Config, NetworkConfig, SacConfig
from ear_jax.envs.batched_env import Transition
from ear_jax.errors import UsageError
from ear_jax.learning import losses, return_scale
from ear_jax.learning.batch import Batch, check_batch
from ear_jax.learning.exploration import held_noise
from ear_jax.learning.optimiser import make_optimiser
from ear_jax.learning.sac import SacLearner
from ear_jax.learning.sac_state import SacState
from ear_jax.methods import Sizes, make_agent
from ear_jax.runs.training import Program, evaluate
from tests.helpers.bandit import bandit_program, begin, draws_of, one_update, train_on
from tests.helpers.probe import Bandit


def bandit(**changes: dict[str, Any]) -> Program:
    """The bandit's program with other settings, by group."""
    base = bandit_program()
    groups = {group: replace(getattr(base.config, group), **values) for group, values in changes.items()}
    config = replace(base.config, **groups)
    agent = make_agent(Sizes(obs=1, action=1, tasks=2, outcomes=1), config)
    return replace(base, config=config, agent=agent, learner=SacLearner(agent, base.family, base.tasks.params, config))


def solve(program: Program) -> SacState:
    """Trains on the bandit; returns the learner's state once its actions are right."""
    state = train_on(program, begin(program), 20)
    played = evaluate(program, state.learner.policy, jax.random.key(2), 4)
    np.testing.assert_allclose(played.late["action"], [[-0.5] * 4, [0.5] * 4], atol=0.1)
    return state.learner


def peaked(bins: int, *at: int) -> jax.Array:
    """Logits [critics, bins], each critic certain of one bin."""
    return jnp.stack([jnp.where(jnp.arange(bins) == one, 60.0, 0.0) for one in at])


def test_a_categorical_target_shares_moved_mass_between_the_nearest_bins():
    """Bins −2 … 2: certain of 1, moved to 0.25 + 0.5 · 1 = 0.75, is 3/4 of bin 1 and 1/4 of bin 0."""
    masses = categorical.target(peaked(5, 3), 0.0, lambda value: 0.25 + 0.5 * value, limit=2.0)
    np.testing.assert_allclose(masses, [0, 0, 0.25, 0.75, 0], atol=1e-5)
    beyond = categorical.target(peaked(5, 3), 0.0, lambda value: 9.0 + value, limit=2.0)
    np.testing.assert_allclose(beyond, [0, 0, 0, 0, 1], atol=1e-5)


@pytest.mark.parametrize(("pessimism", "expected"), [(0.0, 0.5), (1.0, 0.0), (0.5, 0.25)])
def test_a_categorical_target_mixes_in_the_lesser_critic(pessimism, expected):
    masses = categorical.target(peaked(5, 3, 2), pessimism, lambda value: value, limit=2.0)
    assert float(masses @ jnp.linspace(-2, 2, 5)) == pytest.approx(expected, abs=1e-5)


def test_a_categorical_value_is_the_mean_and_its_loss_the_cross_entropy():
    logits = jnp.log(jnp.array([0.1, 0.2, 0.7]))
    assert float(categorical.value(logits, 10.0)) == pytest.approx(6.0, rel=1e-5)
    assert float(categorical.loss(logits, jnp.array([0.0, 0.5, 0.5]))) == pytest.approx(
        -0.5 * np.log(0.2 * 0.7), rel=1e-5
    )


def test_a_scaled_target_is_clipped():
    targets = [float(clipped_target(jnp.array([3.0, value]), 1.0, lambda q: q + 1, 2.5)) for value in (1.0, 2.0, -9.0)]
    assert targets == [2.0, 2.5, -2.5]


def test_a_residual_network_adds_what_its_blocks_make_of_their_input():
    """Two LayerNorms by hand; a block whose last LayerNorm is zero changes nothing."""
    network = residual(3, 1, 2, NetworkConfig(width=4))
    params, x = network.init(jax.random.key(0)), jnp.array([1.0, -2.0, 0.5])
    dense = [params["params"][f"Dense_{index}"]["kernel"] for index in range(4)]

    def normalised(x: np.ndarray) -> np.ndarray:
        return (x - x.mean()) / np.sqrt(x.var() + 1e-6)

    hidden = np.maximum(normalised(x @ dense[0]), 0)
    block = normalised(np.maximum(normalised(hidden @ dense[1]), 0) @ dense[2])
    np.testing.assert_allclose(network.apply(params, x), (hidden + block) @ dense[3], rtol=1e-4, atol=1e-5)


def test_batch_norm_is_by_the_batch_in_training_and_by_its_running_statistics_elsewhere():
    """One layer by hand; an item counts a hundredth of the running statistics, which start at 0 and 1."""
    network = batch_normed(2, (3,), 1, NetworkConfig())
    params, x = network.init(jax.random.key(0)), jnp.array([[1.0, -2.0], [3.0, 0.5], [-1.0, 1.0], [0.0, 4.0]])
    assert network.apply_in_batch
    in_batch = jax.vmap(network.apply_in_batch, (None, 0), out_axes=(0, None), axis_name=BATCH)
    output, statistics = in_batch(params, x)
    hidden, last = (params["params"][f"Dense_{index}"]["kernel"] for index in range(2))

    def normalised(x: np.ndarray, mean: np.ndarray, variance: np.ndarray) -> np.ndarray:
        return (x - mean) / np.sqrt(variance + 1e-3)

    first = normalised(x, x.mean(0), x.var(0)) @ hidden
    by_hand = np.maximum(normalised(first, first.mean(0), first.var(0)), 0) @ last
    np.testing.assert_allclose(output, by_hand, rtol=1e-4, atol=1e-5)
    kept = statistics["batch_stats"]["BatchNorm_0"]
    np.testing.assert_allclose(kept["mean"], 0.01 * x.mean(0), rtol=1e-5)
    np.testing.assert_allclose(kept["var"], 0.99 + 0.01 * x.var(0), rtol=1e-5)
    elsewhere = np.maximum(normalised(normalised(x, 0, 1) @ hidden, 0, 1), 0) @ last
    np.testing.assert_allclose(jax.vmap(network.apply, (None, 0))(params, x), elsewhere, rtol=1e-4, atol=1e-5)


def test_predictions_of_a_step_and_of_the_next_are_normalised_as_one_batch():
    critic = task_critic(1, 1, 2, Config("bandit", network=NetworkConfig(4, critic_layers=1, critic_batch_norm=True)))
    critics = jax.vmap(critic.init)(jax.random.split(jax.random.key(0), 2))
    obs, action = jnp.array([[0.0], [1.0], [4.0], [9.0]]), jnp.array([[0.5], [-0.5], [0.1], [0.9]])
    task = jnp.eye(2)
    now, later, _ = losses.as_one_batch(
        critics, critic, losses.Acts(obs[:2], action[:2]), losses.Acts(obs[2:], action[2:]), task
    )
    assert critic.predict_in_batch
    whole = jax.vmap(critic.predict_in_batch, (None, 0, 0, 0), out_axes=(0, None), axis_name=BATCH)
    for index in range(2):
        of_one = jax.tree.map(lambda leaf, index=index: leaf[index], critics)
        predicted, _ = whole(of_one, obs, action, jnp.tile(task, (2, 1)))
        np.testing.assert_allclose(jnp.concatenate([now[index], later[index]]), predicted, rtol=1e-5)


def test_the_loss_of_predicted_outcomes_is_their_error_in_units_of_spread_and_that_of_the_next_lse():
    """φ(s) = s, predicted unchanged; outcomes 1 and 3 become −1 and 1, of which 0 and 2 are predicted."""
    agent = SimpleNamespace(
        embed=lambda policy, obs: policy * obs, forecast=lambda policy, obs, action: (policy * obs, 2 * action)
    )
    one = jnp.zeros(2)
    batch = Batch(
        obs=jnp.array([[1.0], [2.0]]),
        action=jnp.array([[0.0], [1.0]]),
        next_obs=jnp.array([[1.5], [4.0]]),
        reward=one,
        outcome={"speed": jnp.array([1.0, 3.0])},
        terminated=one,
        task=one,
    )
    loss, slope = jax.value_and_grad(losses.outcome_loss)(1.0, agent, batch)
    assert loss == pytest.approx((0.5**2 + 2.0**2) / 2 + ((0 + 1) ** 2 + (2 - 1) ** 2) / 2, rel=1e-4)
    assert slope == pytest.approx(-0.5 * 1.0 + -2.0 * 2.0), "no gradient through the next LSE"


def test_the_scale_makes_the_largest_return_the_same_for_every_task():
    """Rewards −(a − a*)² of one environment: actions 0.5 and 1.5 earn −1 and −4 of target −0.5, 0 and −1 of 0.5."""
    family = Bandit("native")
    tasks = family.training_tasks().params
    action = jnp.array([0.5, 1.5])[:, None, None] * jnp.ones((2, 2, 1))
    nothing = jnp.zeros((2, 2, 1))
    step = Transition(nothing, nothing, nothing, {"action": action}, nothing, nothing, jnp.ones((2, 2, 1), bool))
    largest = return_scale.largest_reward(family, tasks, step, jnp.array([1.0, 1.0]))
    np.testing.assert_allclose(largest, [2.5, 1.0])
    scale = return_scale.reward_scale(SacConfig(discount=0.9, return_scale=10.0), largest)
    np.testing.assert_allclose(scale * largest / (1 - 0.9), [10.0, 10.0], rtol=1e-6)


def test_noise_is_held_for_times_that_fall_with_their_square():
    noise = jax.random.normal(jax.random.key(0), (400, 2, 50, 3))
    assert held_noise(noise, jax.random.key(1), 1) is noise
    held = np.asarray(held_noise(noise, jax.random.key(1), 4))
    changed = (held[1:] != held[:-1]).all(axis=-1)
    assert (held[1:] == held[:-1])[~changed].all(), "an environment's noise is held as a whole"
    starts = [np.flatnonzero(np.append(True, changed[:, task, env])) for task in range(2) for env in range(50)]
    times = np.concatenate([np.diff(start) for start in starts])
    expected = 1 / np.arange(1, 5) ** 2
    np.testing.assert_allclose(np.bincount(times, minlength=5)[1:] / len(times), expected / expected.sum(), atol=0.01)


def test_weights_decay_and_biases_do_not():
    params = {"Dense_0": {"kernel": jnp.ones(2), "bias": jnp.ones(2)}}
    optimiser = make_optimiser(SacConfig(lr=0.1, weight_decay=0.5))
    update, _ = optimiser.update(jax.tree.map(jnp.zeros_like, params), optimiser.init(params), params)
    np.testing.assert_allclose(update["Dense_0"]["kernel"], -0.05)
    np.testing.assert_allclose(update["Dense_0"]["bias"], 0.0)


def test_the_policy_learns_from_every_second_item_of_each_task():
    """Its gradient is that of a batch which holds these items alone."""
    whole = bandit_program()
    state = begin(whole)
    half = bandit(sac={"policy_share": 2})
    draws = draws_of(half.learner, 1)
    (of_half, critics, _), *_ = jax.jit(half.learner._gradients)(state.learner, state.replay, draws)
    (_, of_all, _), *_ = jax.jit(whole.learner._gradients)(state.learner, state.replay, draws)
    some = bandit(sac={"batch_size": 32})
    picked = jax.tree.map(lambda leaf: leaf[::2], draws)
    (of_some, _, _), *_ = jax.jit(some.learner._gradients)(state.learner, state.replay, picked)
    for one, two in zip(jax.tree.leaves((of_half, critics)), jax.tree.leaves((of_some, of_all)), strict=True):
        np.testing.assert_allclose(one, two, rtol=1e-4, atol=1e-6)


def test_ltes_that_critics_see_are_taught_by_them(monkeypatch):
    program = bandit(network={"critic_task": "both"})
    state = begin(program)
    monkeypatch.setattr("ear_jax.learning.losses.actor_loss", lambda *_: jnp.zeros(()))
    before, after, _ = one_update(program, state)
    moved = jax.tree.map(lambda old, new: bool((old != new).any()), before.policy, after.policy)["networks"]
    assert all(jax.tree.leaves(moved["task_encoder"]))
    assert not any(jax.tree.leaves((moved["encoder"], moved["decoder"])))


@pytest.mark.parametrize(
    "changes",
    [
        pytest.param({"network": {"critic_blocks": 1}, "sac": {"weight_decay": 1e-3}}, marks=pytest.mark.slow),
        {
            "network": {"critic_bins": 21, "critic_blocks": 1, "critic_task": "lte"},
            "sac": {"return_scale": 10.0},
            "collect": {"hold_noise": 4},
        },
    ],
    ids=["residual critics", "categorical critics of residual blocks"],
)
def test_the_bandit_is_solved_with_them(changes):
    solve(bandit(**changes))


def test_critics_with_batch_norm_solve_it_with_unit_weights_and_moving_statistics_while_outcomes_are_predicted():
    network = {"critic_bins": 21, "critic_batch_norm": True}
    critics = solve(bandit(network=network, sac={"return_scale": 10.0, "outcome_weight": 0.1})).critics
    for path, leaf in jax.tree_util.tree_leaves_with_path(critics):
        if is_kernel(path):
            np.testing.assert_allclose(jnp.linalg.norm(leaf, axis=-2), 1.0, rtol=1e-5)
    assert all(bool((leaf != leaf.flatten()[0]).any()) for leaf in jax.tree.leaves(critics["batch_stats"]))


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"sac": {"policy_share": 3}}, "--sac.policy-share 3 does not divide the 32 transitions"),
        ({"network": {"critic_bins": 11}}, "--network.critic-bins needs --sac.return-scale"),
        ({"sac": {"return_scale": 10.0, "discount": 1.0}}, "--sac.return-scale needs --sac.discount below 1"),
        ({"network": {"critic_bins": 1}}, "--network.critic-bins 1 is out of range; it must be 0, for a scalar value"),
        ({"network": {"critic_batch_norm": True, "critic_blocks": 1}}, "build other critics; leave out one"),
    ],
)
def test_what_does_not_fit_is_refused(changes, complaint):
    with pytest.raises(UsageError, match=complaint):
        check_batch(bandit(**changes).config, 2)
