"""The ant's symmetries: four turns and a mirror, and the transitions made with them."""

from __future__ import annotations

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ear_jax.envs import make_family
from ear_jax.envs.symmetry import origins
from ear_jax.physics import Physics
from ear_jax.runs.training import init, make_program
from ear_jax.tasks import task_set
from tests.helpers.bandit import batch_of, draws_of
from tests.helpers.runs import tiny_config

VARIANTS = jnp.arange(8)


@pytest.fixture(scope="module")
def ant():
    return make_family("ant-dir", "native")


def test_variants_are_a_group_that_begins_with_no_change(ant):
    """There are eight different ones, and each has an inverse."""
    for signed in (ant.symmetry.obs, ant.symmetry.action):
        unit = np.eye(signed.order.shape[1])
        each = jax.jit(jax.vmap(jax.vmap(signed, in_axes=(None, 0)), in_axes=(0, None)))(VARIANTS, unit)
        np.testing.assert_array_equal(each[0], unit)
        assert len({np.asarray(one).tobytes() for one in each}) == 8
        products = np.einsum("aij,bjk->abik", each, each)
        assert ((products == unit).all((2, 3)).sum(axis=1) == 1).all()


def test_the_ants_step_turned_is_the_step_of_the_turned_ant(ant):
    """C MuJoCo steps ants on the move alike, to rounding; the commanded direction turns with them."""
    symmetry, n = ant.symmetry, 64
    task = ant.parse_task("15").params
    keys = jax.random.split(jax.random.key(0), n)
    state = jax.jit(jax.vmap(lambda key: ant.start(key, jax.tree.map(jnp.float32, task))))(keys)
    actions = jax.random.uniform(jax.random.key(1), (30, n, 8), minval=-1)
    step_all = jax.jit(jax.vmap(ant.step))
    for action in actions:
        state = step_all(state, action)
    physics, action = state.pipeline_state, actions[0]
    # Without a warm start, which belongs to the ant before the turn.
    place = jnp.concatenate([jnp.zeros((n, 2)), physics.qpos[:, 2:], physics.qvel], axis=1)

    def step(seen, action):
        start = Physics(jnp.concatenate([jnp.zeros(2), seen[:13]]), seen[13:], jnp.zeros(14))
        motion = ant.engine.step(start, action)
        return ant.observe(motion.after), ant.outcome(motion)

    def both(variant, seen, action):
        obs, outcome = step(seen, action)
        turned = step(symmetry.obs(variant, seen), symmetry.action(variant, action))
        return (symmetry.obs(variant, obs), symmetry.outcome(variant, outcome)), turned, outcome

    of_all = jax.jit(jax.vmap(jax.vmap(both, in_axes=(0, None, None)), in_axes=(None, 0, 0)))
    expected, found, plain = of_all(VARIANTS, place[:, 2:], action)
    for one, two in zip(jax.tree.leaves(expected), jax.tree.leaves(found), strict=True):
        np.testing.assert_allclose(one, two, atol=2e-3, rtol=1e-3)
    turned = jax.jit(jax.vmap(lambda variant: symmetry.task(variant, jax.tree.map(jnp.float32, task))))(VARIANTS)
    again = jax.jit(jax.vmap(jax.vmap(ant.reward, in_axes=(0, 0)), in_axes=(0, None)))(found[1], turned)
    reward = jax.jit(jax.vmap(ant.reward, in_axes=(0, None)))({name: leaf[:, 0] for name, leaf in plain.items()}, task)
    np.testing.assert_allclose(again, np.broadcast_to(np.asarray(reward)[:, None], again.shape), atol=1e-2)


def test_tasks_become_tasks(ant):
    """A quarter turn adds 90 degrees, a flip changes the sign; with three tasks, some variants have no source."""
    found = jax.jit(partial(origins, ant.symmetry))
    source, exists = found(ant.training_tasks().params)
    assert exists.all()
    angles = np.arange(24) * 15
    turned = np.array(
        [
            (sign * angles[source[number]] + 90 * quarter) % 360
            for number, (sign, quarter) in enumerate((sign, quarter) for sign in (1, -1) for quarter in range(4))
        ]
    )
    np.testing.assert_array_equal(turned, np.broadcast_to(angles, (8, 24)))
    three = task_set([ant.parse_task(angle) for angle in ("0", "90", "45")]).params
    _, exists = found(three)
    np.testing.assert_array_equal(exists.sum(axis=1), [3, 1, 0, 1, 1, 3, 1, 0])


def test_a_batch_keeps_a_tasks_own_transitions_its_own(ant):
    """With symmetry and own shares alone, every item's outcome lies where its task's lie."""
    config = tiny_config(family="ant-dir", tasks=("0", "90", "180", "270"))
    replay = dataclasses.replace(config.replay, share_experience=True, own_share=1.0, symmetry=True)
    program = make_program(dataclasses.replace(config, replay=replay))
    state = jax.jit(partial(init, program))(jax.random.key(0))
    rings = state.replay.rings
    params = program.tasks.params
    outcome = {
        **rings.outcome,
        "velocity_x": 0 * rings.outcome["velocity_x"] + params["x"][:, None],
        "velocity_y": 0 * rings.outcome["velocity_y"] + params["y"][:, None],
    }
    buffer = dataclasses.replace(
        state.replay, rings=dataclasses.replace(rings, outcome=outcome), added=jnp.full(4, 50, jnp.int32)
    )
    draws = draws_of(program.learner, 1)
    assert len(set(draws.variant.tolist())) == 8
    batch = batch_of(program.learner, dataclasses.replace(state, replay=buffer), draws)
    np.testing.assert_allclose(batch.reward / program.config.sac.reward_scale, 2.0, atol=1e-5)
