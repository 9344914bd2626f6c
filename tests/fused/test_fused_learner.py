"""Training with fused kernels against training with XLA's, and the choice between them."""

from __future__ import annotations

import dataclasses
from functools import partial

import jax
import numpy as np
import pytest

from ear_jax.errors import UsageError
from ear_jax.fused import choice, choose_learner, why_not
from ear_jax.fused.learner import FusedSacLearner
from ear_jax.learning.sac import SacLearner
from ear_jax.methods import METHODS, find_method
from ear_jax.presets import preset_config
from ear_jax.process.target import tracing_for
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


@pytest.mark.parametrize("name", sorted(METHODS))
def test_every_method_has_fused_kernels_or_keeps_its_own_learner(name, monkeypatch):
    config = preset_config("halfcheetah-vel", "fast", name)
    learner = find_method(name).learner
    asked = network(config, kernels="fused")
    assert choose_learner(learner, config) is learner, "a CPU takes XLA's"
    with tracing_for("gpu"):
        assert choose_learner(learner, config) is learner, "not yet proven"
        monkeypatch.setattr(choice, "PROVEN", True)
        chosen = choose_learner(learner, config)
        assert choose_learner(learner, network(config, kernels="xla")) is learner
    if name == "ear":
        assert chosen is choose_learner(learner, asked) is FusedSacLearner
    else:
        assert chosen is learner
        with pytest.raises(UsageError, match=f"they are for agent ear, not {name}; try --network.kernels xla"):
            choose_learner(learner, asked)


def test_sizes_that_do_not_apply_are_named():
    config = preset_config("halfcheetah-vel", "fast")
    sac = dataclasses.replace(config.sac, batch_size=490)
    for changed, words in (
        (network(config, width=400), "--network.width 400 is not a multiple of 64 up to 512"),
        (network(config, critic_layers=4), "--network.critic-layers 4 is not from 1 to 3"),
        (network(config, critic_blocks=2), "neither residual blocks nor bins"),
        (network(config, critic_layer_norm=False), "critics need LayerNorm"),
        (dataclasses.replace(config, sac=dataclasses.replace(config.sac, weight_decay=0.1)), "no weight decay"),
        (dataclasses.replace(config, sac=sac), "a batch of 490 is not a multiple of 16"),
    ):
        assert words in (why_not(SacLearner, changed) or "")
    assert why_not(SacLearner, preset_config("halfcheetah-vel", "fast+wide")) is None
    assert why_not(SacLearner, preset_config("halfcheetah-vel", "smoke")) is None
