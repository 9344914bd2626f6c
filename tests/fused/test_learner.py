"""Training with fused kernels against training with XLA's, in Pallas's interpreter."""

from __future__ import annotations

import dataclasses
from functools import partial

import jax
import numpy as np
import pytest

from ear_jax.fused.learner import FusedSacLearner
from ear_jax.runs import training
from ear_jax.runs.compiled import fill_replay
from ear_jax.runs.leaves import named_leaves
from tests.helpers.runs import compiled, tiny_config

EPOCHS = 20


def network(config, **changes):
    return dataclasses.replace(config, network=dataclasses.replace(config.network, **changes))


def fusable(**changes):
    base = tiny_config(seeds=2, **changes)
    base = dataclasses.replace(base, sac=dataclasses.replace(base.sac, batch_size=64, updates=2))
    return network(base, width=64)


@pytest.mark.slow
def test_a_run_of_20_epochs_ends_within_rounding_of_the_reference():
    """Adam enlarges rounding, so the measure is a reference run whose start differs in the seventh digit.

    Each run collects with its own policy.
    """
    config = fusable()
    reference = compiled(config)
    program = training.make_program(network(config, kernels="fused"))
    assert isinstance(program.learner, FusedSacLearner)
    learn = jax.jit(jax.vmap(partial(training.learn, program)))
    start = fill_replay(reference, reference.init(training.seed_keys(config)), 2)
    states = [jax.tree.map(lambda leaf: leaf.copy(), start) for _ in range(3)]
    shaken = jax.tree.map(lambda leaf: leaf * (1 + 1e-7), states[2].learner.policy["networks"])
    policy = {**states[2].learner.policy, "networks": shaken}
    states[2] = dataclasses.replace(states[2], learner=dataclasses.replace(states[2].learner, policy=policy))
    metrics = [{}, {}, {}]
    for _ in range(EPOCHS):
        for index, update in enumerate((reference.learn, learn, reference.learn)):
            states[index], metrics[index] = update(reference.collect(states[index])[0])
    plain, fused, other = (named_leaves(state.learner) for state in states)
    assert plain.keys() == fused.keys()
    assert metrics[0].keys() == metrics[1].keys()
    for part in ("policy.", "critics.", "target_critics.", "log_temperature"):
        names = [name for name in plain if name.startswith(part)]
        apart = [np.concatenate([np.ravel(plain[n] - leaves[n]) for n in names]) for leaves in (fused, other)]
        size = np.linalg.norm(np.concatenate([np.ravel(plain[n]) for n in names]))
        assert np.linalg.norm(apart[0]) < 5 * np.linalg.norm(apart[1]) + 1e-6 * size, part
