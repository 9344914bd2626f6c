"""Agents that turn with the robot: equal behaviour in symmetric situations, and a table of LTEs that turns too."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ear_jax.agents.equivariant import nearest, symmetrised
from ear_jax.agents.networks import Standardiser
from ear_jax.envs import make_family
from ear_jax.errors import UsageError
from ear_jax.presets import preset_config
from ear_jax.runs.training import TrainState, init, make_program, with_numbers

VARIANTS = jnp.arange(8)


@pytest.fixture(scope="module")
def program():
    config = preset_config("ant-dir", "fast+equivariant")
    return make_program(replace(config, network=replace(config.network, width=16)))


@pytest.fixture(scope="module")
def policy(program):
    """Networks whose outputs depend on all of their inputs, and statistics of observations."""
    policy = program.agent.init_policy(jax.random.key(0))
    found = Standardiser(
        jax.random.normal(jax.random.key(1), (27,)), jnp.exp(jax.random.normal(jax.random.key(2), (27,)))
    )
    return {**policy, "standardiser": symmetrised(found, program.family.symmetry)}


def turned_code(symmetry, variant, code):
    return jnp.concatenate([symmetry.plane(variant, code[:2]), code[2:]])


def test_the_policy_turns_with_the_robot(program, policy):
    """π(g z, g s) = g π(z, s) for LTEs anywhere on the sphere."""
    symmetry, n = program.family.symmetry, 50
    obs = jax.random.normal(jax.random.key(3), (n, 27))
    codes = jax.vmap(program.agent.project)(jax.random.normal(jax.random.key(4), (n, 3)))

    def both(variant, code, obs):
        found = program.agent.distribution(policy, turned_code(symmetry, variant, code), symmetry.obs(variant, obs))
        plain = program.agent.distribution(policy, code, obs)
        return found, (symmetry.action(variant, plain.mean), symmetry.action.unsigned(variant, plain.log_std))

    found, wanted = jax.jit(jax.vmap(jax.vmap(both, (0, None, None)), (None, 0, 0)))(VARIANTS, codes, obs)
    np.testing.assert_allclose(found.mean, wanted[0], atol=1e-5)
    np.testing.assert_allclose(found.log_std, wanted[1], atol=1e-5)
    assert np.std(found.mean) > 0.01


def test_a_sweep_makes_it_while_it_is_traced(program):
    def begun(lr: jax.Array) -> TrainState:
        return init(with_numbers(program, {"sac.lr": lr}), jax.random.key(0))

    traced, usual = (jax.eval_shape(begin, 1e-3) for begin in (begun, lambda _: init(program, jax.random.key(0))))
    assert jax.tree.map(jnp.shape, traced) == jax.tree.map(jnp.shape, usual)


@pytest.mark.parametrize("seen", ["onehot", "lte", "both"])
def test_critics_value_symmetric_tasks_alike(program, seen):
    """Q(g s, g a, g τ) = Q(s, a, τ), whatever critics see of the task."""
    config = replace(program.config, network=replace(program.config.network, critic_task=seen))
    symmetry, agent = program.family.symmetry, make_program(config).agent
    codes = agent.codes(agent.init_policy(jax.random.key(3)))
    inputs = {"onehot": jnp.eye(24), "lte": codes, "both": jnp.concatenate([jnp.eye(24), codes], axis=1)}[seen]
    params = agent.critic.init(jax.random.key(0))
    obs, action = jax.random.normal(jax.random.key(1), (27,)), jax.random.normal(jax.random.key(2), (8,))
    predict = jax.jit(agent.critic.predict)
    plain = predict(params, obs, action, inputs[1])  # dir-15
    for variant, task in ((1, 7), (2, 13), (4, 23)):  # turned by 90° and 180°, and mirrored
        np.testing.assert_allclose(
            predict(params, symmetry.obs(variant, obs), symmetry.action(variant, action), inputs[task]),
            plain,
            rtol=1e-4,
        )
    assert abs(float(predict(params, obs, action, inputs[2]) - plain)) > 1e-4


@pytest.mark.parametrize("method", ["multihead", "onehot"])
def test_a_one_hot_turns_with_its_task(method, program):
    """π(g τ, g s) = g π(τ, s) for τ = dir-15, turned by 90° and 180°, and mirrored; dir-30 is not symmetric to it."""
    config = preset_config("ant-dir", "fast+equivariant", method)
    agent = make_program(replace(config, network=replace(config.network, width=16))).agent
    symmetry, policy = program.family.symmetry, agent.init_policy(jax.random.key(0))
    obs, codes = jax.random.normal(jax.random.key(1), (27,)), agent.codes(policy)
    np.testing.assert_array_equal(codes, np.eye(24))
    act = jax.jit(agent.distribution)
    plain = act(policy, codes[1], obs)
    for variant, task in ((1, 7), (2, 13), (4, 23)):
        found = act(policy, codes[task], symmetry.obs(variant, obs))
        np.testing.assert_allclose(found.mean, symmetry.action(variant, plain.mean), atol=1e-5)
        np.testing.assert_allclose(found.log_std, symmetry.action.unsigned(variant, plain.log_std), atol=1e-5)
    assert np.abs(act(policy, codes[2], obs).mean - plain.mean).max() > 0.01


def test_ltes_of_symmetric_tasks_are_symmetric(program, policy):
    """A quarter turn adds 90° to a direction and turns its LTE; 0° and 45° have theirs on a mirror's axis."""
    codes = np.asarray(jax.jit(program.agent.codes)(policy))
    np.testing.assert_allclose(np.linalg.norm(codes, axis=1), 1, atol=1e-5)
    np.testing.assert_allclose(codes[(np.arange(24) + 6) % 24], codes @ [[0, 1, 0], [-1, 0, 0], [0, 0, 1]], atol=1e-5)
    np.testing.assert_allclose(codes[-np.arange(24) % 24], codes * [1, -1, 1], atol=1e-5)
    angles = np.degrees(np.arctan2(codes[:4, 1], codes[:4, 0]))
    np.testing.assert_allclose(angles[[0, 3]], [0, 45], atol=1e-2)
    assert (angles[1:3] >= 0).all()
    assert (angles[1:3] <= 45).all()


def test_a_value_sees_one_task_in_place_of_all_that_are_symmetric_to_it(program):
    symmetry, canonical = program.family.symmetry, jax.jit(program.agent.canonical)
    obs = jax.random.normal(jax.random.key(0), (27,))
    plain, first = canonical(obs, 1)
    for variant, task in ((1, 7), (2, 13), (4, 23)):
        seen, which = canonical(symmetry.obs(variant, obs), task)
        np.testing.assert_array_equal(seen, plain)
        assert which == first == 1


def test_one_variant_brings_a_vector_into_the_sector(program):
    symmetry = program.family.symmetry
    vectors = np.concatenate([np.random.default_rng(0).normal(size=(100, 2)), np.eye(2), -np.eye(2), [[1, 1], [1, -1]]])
    variant = np.asarray(jax.jit(jax.vmap(lambda vector: nearest(symmetry, vector)))(jnp.float32(vectors)))
    np.testing.assert_array_equal(variant.sum(axis=1), 1)
    x, y = np.asarray(jax.vmap(symmetry.plane.select)(variant, jnp.float32(vectors))).T
    assert (y >= -1e-6).all()
    assert (x >= y - 1e-6).all()


def test_statistics_are_those_of_all_variants():
    symmetry = make_family("ant-dir", "native").symmetry
    obs = np.random.default_rng(0).normal(size=(500, 27)).astype(np.float32) * np.arange(1, 28) + 3
    plain = Standardiser(jnp.asarray(obs.mean(0)), jnp.asarray(1 / obs.std(0)))
    every = np.concatenate([jax.vmap(lambda one, v=v: symmetry.obs(v, one))(obs) for v in range(8)])
    found = symmetrised(plain, symmetry)
    np.testing.assert_allclose(found.mean, every.mean(0), atol=1e-4)
    np.testing.assert_allclose(found.scale, 1 / every.std(0), rtol=1e-3)


@pytest.mark.parametrize(
    ("family", "settings", "complaint"),
    [
        ("halfcheetah-vel", {"equivariant": True}, "halfcheetah-vel has no symmetry"),
        ("ant-dir", {"equivariant": True, "lte_size": 1}, "--network.lte-size is 1"),
    ],
)
def test_what_cannot_be_turned_is_refused(family, settings, complaint):
    config = preset_config(family, "fast")
    with pytest.raises(UsageError, match=complaint):
        make_program(replace(config, network=replace(config.network, **settings)))
