"""An obedient agent with a network, at first of zeros, that is added to what it does."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp

from ear_jax.agents import Agent, standardised
from ear_jax.agents.networks import mlp
from ear_jax.agents.tanh_gaussian import Gaussian
from ear_jax.config import Config, NetworkConfig
from ear_jax.runs.trained import Trained
from ear_jax.runs.training import Program
from tests.helpers.obedient import CODES, obedient
from tests.helpers.probe import Clock


def teachable() -> Agent:
    network, base = mlp(4, (32,), 1, NetworkConfig(initialiser="fan_in")), obedient(CODES)

    def init(key):
        params = network.init(key)
        params["params"]["Dense_1"] = jax.tree.map(jnp.zeros_like, params["params"]["Dense_1"])
        return params

    def distribution(policy, code, obs):
        plain = base.distribution(policy, code, obs)
        return Gaussian(plain.mean + network.apply(policy, jnp.concatenate([obs, code])), plain.log_std)

    return standardised(dataclasses.replace(base, init_policy=init, distribution=distribution), 1)


def on_clock(seeds: int = 1) -> Trained:
    """Returns untrained policies of a teachable agent on `Clock`."""
    family, agent = Clock("native"), teachable()
    program = Program(Config("clock", seeds=seeds), family, family.training_tasks(), agent, None)  # type: ignore[arg-type]
    keys = jax.random.split(jax.random.key(0), seeds)
    return Trained("toy", program, jax.vmap(agent.init_policy)(keys), 0)
