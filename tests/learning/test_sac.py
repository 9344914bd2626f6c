"""SAC's updates: the parts they move and leave alone, and problems whose solution is known."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ear_jax.runs import training
from ear_jax.runs.training import Program
from tests.helpers.bandit import (
    all_draws,
    bandit_program,
    batch_of,
    begin,
    draws_of,
    one_update,
    played,
    target_of,
    train_on,
)


@pytest.fixture(scope="module")
def program() -> Program:
    return bandit_program()


@pytest.fixture(scope="module")
def begun(program: Program) -> training.TrainState:
    return begin(program)


def test_code_alone_tells_two_tasks_apart(program, begun):
    """Same observation, opposite targets: solved only through the LTEs. The temperature is learnt too."""
    state = train_on(program, begun, 20)
    episodes = played(program, state.learner.policy, 4)
    np.testing.assert_allclose(episodes.late["action"], [[-0.5] * 4, [0.5] * 4], atol=0.1)


def test_lte_rows_have_unit_norm(program, begun):
    codes = program.agent.codes(begun.learner.policy)
    assert codes.shape == (2, 3)
    np.testing.assert_allclose(np.linalg.norm(codes, axis=1), 1, rtol=1e-5)
    moved = program.agent.project(codes[0] + program.agent.code_noise * jnp.ones(3))
    assert np.linalg.norm(moved) == pytest.approx(1, rel=1e-5)
    assert 0 < np.linalg.norm(moved - codes[0]) < 0.1


def test_first_adam_step_is_the_learning_rate(program, begun):
    """In every layer the parameters with a gradient move by lr, the temperature up or down by exactly that."""
    before, after, metrics = one_update(program, begun)
    assert abs(float(after.log_temperature - before.log_temperature)) == pytest.approx(1e-2, rel=1e-3)
    for learnt in (lambda state: state.critics, lambda state: state.policy["networks"]):
        for old, new in zip(jax.tree.leaves(learnt(before)), jax.tree.leaves(learnt(after)), strict=True):
            assert np.abs(new - old).max() == pytest.approx(1e-2, rel=1e-2)
    assert all(np.isfinite(value).all() for value in metrics.values())


def test_the_step_size_falls_evenly_to_a_tenth():
    """Under a gradient that stays the same, Adam moves by the step size."""
    optimiser = bandit_program(lr_decay=4).learner.optimiser
    state, moves = optimiser.init(jnp.zeros(1)), []
    for _ in range(6):
        move, state = optimiser.update(jnp.ones(1), state)
        moves.append(-float(move[0]))
    np.testing.assert_allclose(moves, 1e-2 * np.array([1, 0.775, 0.55, 0.325, 0.1, 0.1]), rtol=1e-3)


def test_target_critics_follow_by_tau(program, begun):
    before, after, _ = one_update(program, begun)
    for old, target, new in zip(
        *map(jax.tree.leaves, (before.target_critics, after.target_critics, after.critics)), strict=True
    ):
        np.testing.assert_allclose(target, 0.995 * old + 0.005 * new, rtol=1e-4, atol=1e-7)


def test_critics_are_independent(program, begun):
    """Disturbing one critic's parameters leaves the other's update as it was (the policy sees both, critics do not)."""
    disturbed = jax.tree.map(lambda leaf: leaf.at[1].multiply(1.5), begun.learner.critics)
    _, plain, _ = one_update(program, begun)
    _, other, _ = one_update(program, begun, critics=disturbed)
    for one, two in zip(jax.tree.leaves(plain.critics), jax.tree.leaves(other.critics), strict=True):
        np.testing.assert_array_equal(one[0], two[0])
    pairs = zip(jax.tree.leaves(plain.critics), jax.tree.leaves(other.critics), strict=True)
    assert any((one[1] != two[1]).any() for one, two in pairs)


def test_batches_are_balanced_and_sources_follow_the_setting(program):
    own = all_draws(program.learner, 0, 3).source
    np.testing.assert_array_equal(own, np.broadcast_to(np.repeat([0, 1], 32), (3, 64)))
    replay = dataclasses.replace(program.config.replay, share_experience=True)
    shared = dataclasses.replace(program.learner, config=dataclasses.replace(program.config, replay=replay))
    source = np.asarray(all_draws(shared, 0, 100).source)
    assert source[:, :32].mean() == pytest.approx(0.5, abs=0.05)
    half = dataclasses.replace(
        shared, config=dataclasses.replace(shared.config, replay=dataclasses.replace(replay, own_share=0.5))
    )
    assert np.asarray(all_draws(half, 0, 100).source)[:, :32].mean() == pytest.approx(0.25, abs=0.05)


def test_shared_transitions_are_scored_for_the_task_they_teach(program, begun):
    replay = dataclasses.replace(program.config.replay, share_experience=True)
    learner = dataclasses.replace(program.learner, config=dataclasses.replace(program.config, replay=replay))
    draws = draws_of(learner, 3)
    batch = batch_of(learner, begun, draws)
    target = np.array([-0.5, 0.5])[np.asarray(batch.task)]
    np.testing.assert_allclose(batch.reward, -((np.asarray(batch.action)[:, 0] - target) ** 2), rtol=1e-5)
    assert (np.asarray(draws.source) != np.asarray(batch.task)).any()


def test_truncation_bootstraps_and_termination_does_not(program, begun):
    draws = draws_of(program.learner, 1)
    batch = batch_of(program.learner, begun, draws)
    assert batch.terminated.all(), "every step of a bandit ends it"
    np.testing.assert_allclose(target_of(program.learner, begun, batch, draws), batch.reward)
    going = dataclasses.replace(batch, terminated=jnp.zeros_like(batch.terminated))
    assert (target_of(program.learner, begun, going, draws) != batch.reward).all()


def test_pessimism_weighs_the_critics_for_the_policy_and_for_the_target(program, begun):
    draws = draws_of(program.learner, 1)
    batch = batch_of(program.learner, begun, draws)
    going = dataclasses.replace(batch, terminated=jnp.zeros_like(batch.terminated))
    table = program.agent.codes(begun.learner.policy)

    def of(pessimism: jax.Array) -> tuple[jax.Array, jax.Array]:
        sac = dataclasses.replace(program.config.sac, pessimism=pessimism)
        learner = dataclasses.replace(program.learner, config=dataclasses.replace(program.config, sac=sac))
        metrics = learner._gradients(begun.learner, begun.replay, draws)[2]
        return metrics["actor_loss"], jnp.mean(learner._target(begun.learner, going, table, draws.next)[-1])

    losses, targets = jax.jit(jax.vmap(of))(jnp.array([0.0, 0.5, 1.0]))  # compiled once for all three
    assert losses[0] < losses[1] < losses[2]
    assert targets[0] > targets[1] > targets[2]
