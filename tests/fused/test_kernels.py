"""Fused kernels against the networks they stand for: values and gradients on random inputs, in Pallas's interpreter."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ear_jax.agents.critic import task_critic
from ear_jax.fused.critic import CriticLayout, value_of_item
from ear_jax.fused.policy import PolicyLayout, head_of_item
from ear_jax.methods import Sizes
from ear_jax.methods.ear import ear
from ear_jax.presets import preset_config

OBS, ACT, TASKS, ITEMS, CRITICS = 5, 2, 3, 64, 2
CASES = [
    *(pytest.param(layers, "float32", marks=pytest.mark.slow) for layers in (1, 3)),
    (2, "float32"),
    (2, "bfloat16"),
]
TOLERANCE = {"float32": 1e-6, "bfloat16": 2e-3}  # of a gradient, relative to its norm


def config_of(layers: int, matmul: str = "float32", width: int = 64):
    config = preset_config("halfcheetah-vel", "smoke")
    changes = {"width": width, "matmul": matmul, "critic_layers": layers, "decoder_layers": layers}
    return dataclasses.replace(
        config, network=dataclasses.replace(config.network, **changes, encoder_layers=max(1, layers - 1))
    )


def jittered(params, key):
    """Adds noise to every parameter, so that none is 0 or 1 as at the start."""
    leaves, structure = jax.tree.flatten(params)
    keys = jax.random.split(key, len(leaves))
    return structure.unflatten(
        leaf + 0.1 * jax.random.normal(k, leaf.shape) for leaf, k in zip(leaves, keys, strict=True)
    )


def error(found, expected) -> float:
    """Returns the largest error of a leaf, relative to the norm of the leaf and at least 1e-3 of the whole's."""
    whole = np.sqrt(sum(float(jnp.sum(leaf**2)) for leaf in jax.tree.leaves(expected)))
    return max(
        float(jnp.linalg.norm(a - b)) / max(float(jnp.linalg.norm(b)), 1e-3 * whole)
        for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True)
    )


@pytest.mark.parametrize(("layers", "matmul"), CASES)
def test_critics_and_their_gradients_are_those_of_the_networks(layers, matmul):
    config = config_of(layers, matmul)
    critic = task_critic(OBS, ACT, TASKS, config)
    layout = CriticLayout(OBS + ACT + TASKS, config.network.width, layers, matmul == "bfloat16")
    keys = jax.random.split(jax.random.key(0), 4)
    params = jittered(jax.vmap(critic.init)(jax.random.split(keys[0], CRITICS)), keys[1])
    x, weights = jax.random.normal(keys[2], (ITEMS, layout.inputs)), jax.random.normal(keys[3], (CRITICS, ITEMS))
    value = value_of_item(layout)

    def reference(params, x):
        obs, action, task = x[:, :OBS], x[:, OBS : OBS + ACT], x[:, OBS + ACT :]
        return jax.vmap(jax.vmap(critic.predict, (None, 0, 0, 0)), (0, None, None, None))(params, obs, action, task)

    def fused(params, x):
        return jax.vmap(jax.vmap(value, (None, 0)), (0, None))(jax.vmap(layout.pack)(params), x)

    def gradients(q):
        return jax.grad(lambda params, x: jnp.sum(weights * q(params, x)), (0, 1))(params, x)

    jax.tree.map(np.testing.assert_array_equal, jax.vmap(lambda p: layout.unpack(layout.pack(p)))(params), params)
    assert error(fused(params, x), reference(params, x)) < TOLERANCE[matmul]
    assert error(gradients(fused), gradients(reference)) < TOLERANCE[matmul]


@pytest.mark.parametrize(("layers", "matmul"), CASES)
@pytest.mark.parametrize("sphere", [True, False])
def test_policies_and_their_gradients_are_those_of_the_networks(layers, matmul, sphere):
    config = config_of(layers, matmul)
    config = dataclasses.replace(config, network=dataclasses.replace(config.network, normalise_lse=sphere, lse_size=7))
    network, agent = config.network, ear(Sizes(OBS, ACT, TASKS), config)
    layout = PolicyLayout(
        OBS, 7, network.lte_size, 2 * ACT, network.width, network.encoder_layers, layers, sphere, matmul == "bfloat16"
    )
    keys = jax.random.split(jax.random.key(1), 5)
    policy = jittered(agent.init_policy(keys[0]), keys[1])
    obs, codes = jax.random.normal(keys[2], (ITEMS, OBS)), jax.random.normal(keys[3], (ITEMS, network.lte_size))
    weights, head = jax.random.normal(keys[4], (ITEMS, 2 * ACT)), head_of_item(layout)

    def reference(policy, codes):
        gaussians = jax.vmap(agent.distribution, (None, 0, 0))(policy, codes, obs)
        return jnp.concatenate([gaussians.mean, gaussians.log_std], axis=1)

    def fused(policy, codes):
        return jax.vmap(head, (None, 0, 0))(layout.pack(policy), obs, codes)

    def gradients(outputs):
        return jax.grad(lambda policy, codes: jnp.sum(weights * outputs(policy, codes)), (0, 1))(policy, codes)

    own = {name: policy[name] for name in ("encoder", "decoder")}
    jax.tree.map(np.testing.assert_array_equal, layout.unpack(layout.pack(policy)), own)
    assert error(fused(policy, codes), reference(policy, codes)) < TOLERANCE[matmul]
    assert error(gradients(fused), gradients(reference)) < TOLERANCE[matmul]
