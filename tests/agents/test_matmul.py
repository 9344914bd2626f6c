"""Matmuls of bfloat16 numbers: their rounding, and that a batch's gradient is one product."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.extend.core import Jaxpr, jaxprs_in_params

from ear_jax.agents.matmul import bfloat16_matmul
from ear_jax.config import Config
from ear_jax.methods import Sizes, make_agent
from ear_jax.runs.training import make_program
from tests.helpers.bandit import bandit_program, begin, one_update

ITEMS, INPUTS, OUTPUTS, CRITICS = 20, 24, 16, 2


def whole(key: int, *shape: int) -> jax.Array:
    """Whole numbers from −8 to 8: bfloat16 holds them, and float32 their products and sums."""
    return jax.random.randint(jax.random.key(key), shape, -8, 9).astype(jnp.float32)


def loss(matmul: Any, kernels: jax.Array, x: jax.Array) -> jax.Array:
    """Sums over critics and items, each item's product weighed by a number of its own; kernels [critics, in, out]."""
    of_items = jax.vmap(jax.vmap(matmul, (0, None)), (None, 0))(x, kernels)
    return jnp.sum(of_items * whole(2, CRITICS, ITEMS, OUTPUTS))


def test_numbers_that_bfloat16_holds_are_multiplied_as_float32_would():
    kernels, x = whole(0, CRITICS, INPUTS, OUTPUTS), whole(1, ITEMS, INPUTS)
    rounded, plain = (jax.jit(jax.value_and_grad(partial(loss, by), (0, 1))) for by in (bfloat16_matmul, jnp.dot))
    for mine, theirs in zip(*map(jax.tree.leaves, (rounded(kernels, x), plain(kernels, x))), strict=True):
        assert mine.dtype == jnp.float32
        np.testing.assert_array_equal(mine, theirs)
    np.testing.assert_array_equal(bfloat16_matmul(x[0], kernels[0]), x[0] @ kernels[0])
    each = jax.vmap(bfloat16_matmul)(x[:CRITICS], kernels)
    np.testing.assert_array_equal(each, [x[0] @ kernels[0], x[1] @ kernels[1]])


def test_factors_are_rounded_to_eight_bits_and_sums_are_not():
    assert bfloat16_matmul(jnp.ones(1), jnp.full((1, 1), 1 + 2**-9))[0] == 1
    assert bfloat16_matmul(jnp.ones(1), jnp.full((1, 1), 1 + 2**-7))[0] == 1 + 2**-7
    assert bfloat16_matmul(jnp.ones(301), jnp.ones((301, 1)))[0] == 301  # which bfloat16 does not hold
    value = jax.vmap(bfloat16_matmul, (0, None))
    slope = jax.grad(lambda x: jnp.sum((1 + 2**-9) * value(x, jnp.ones((1, 1)))))(jnp.ones((1, 1)))
    assert slope[0, 0] == 1, "the gradient that comes in is a factor too"


def shapes(jaxpr: Jaxpr) -> set[tuple[int, ...]]:
    """Returns the shapes of everything that a traced program computes."""
    found = {tuple(out.aval.shape) for equation in jaxpr.eqns for out in equation.outvars}
    return found.union(*(shapes(inner) for equation in jaxpr.eqns for inner in jaxprs_in_params(equation.params)))


def test_a_batchs_gradient_is_no_sum_of_its_items():
    """Such a sum holds a matrix for every item, where one product gives their sum at once."""
    gradient = jax.make_jaxpr(jax.grad(partial(loss, bfloat16_matmul), (0, 1)))
    found = shapes(gradient(whole(0, CRITICS, INPUTS, OUTPUTS), whole(1, ITEMS, INPUTS)).jaxpr)
    assert (CRITICS, INPUTS, OUTPUTS) in found
    assert not any({ITEMS, INPUTS, OUTPUTS} <= set(shape) for shape in found)


def test_learning_rounds_and_acting_does_not():
    config = Config("halfcheetah-vel", engine="native", sac=replace(Config("").sac, batch_size=10))
    program = make_program(replace(config, network=replace(config.network, width=8, matmul="bfloat16")))
    policy = jax.jit(program.agent.init_policy)(jax.random.key(0))
    code, obs = program.agent.codes(policy)[0], jax.random.normal(jax.random.key(1), (17,))
    plain = make_agent(
        Sizes(17, 6, 10), replace(program.config, network=replace(program.config.network, matmul="float32"))
    )
    agents = (program.agent, program.learner.agent, plain)
    means = jax.jit(lambda *given: [agent.distribution(*given).mean for agent in agents])
    acted, learnt, same = means(policy, code, obs)
    np.testing.assert_array_equal(acted, same)
    assert 0 < np.abs(learnt - acted).max() < 0.02


@pytest.mark.parametrize(
    "agent",
    ["ear", *(pytest.param(name, marks=pytest.mark.slow) for name in ("ear-rnn", "multihead", "onehot", "pearl"))],
)
def test_an_update_is_nearly_float32s(agent: str):
    """The gradient of each network, Adam's first moment, points the same way."""
    program = bandit_program(agent)
    state = begin(program)
    network = replace(program.config.network, matmul="bfloat16")
    rounding = make_agent(Sizes(program.family.observation_size, 1, 2), replace(program.config, network=network))
    rounded = replace(program, learner=replace(program.learner, agent=rounding))
    steps = [one_update(by, state)[1] for by in (program, rounded)]
    for moment in (lambda state: state.policy_optimiser, lambda state: state.critic_optimiser):
        plain, mine = (
            jnp.concatenate([leaf.ravel() for leaf in jax.tree.leaves(moment(after)[1][0].mu)]) for after in steps
        )
        assert (plain != mine).any()
        assert plain @ mine > 0.999 * jnp.linalg.norm(plain) * jnp.linalg.norm(mine)
