"""The choice between fused kernels and XLA's."""

from __future__ import annotations

import dataclasses

import pytest

from ear_jax.errors import UsageError
from ear_jax.fused import choice, choose_learner, why_not
from ear_jax.fused.learner import FusedSacLearner
from ear_jax.learning.sac import SacLearner
from ear_jax.methods import METHODS, find_method
from ear_jax.presets import preset_config
from ear_jax.process.target import tracing_for


def network(config, **changes):
    return dataclasses.replace(config, network=dataclasses.replace(config.network, **changes))


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
        (network(config, critic_blocks=2), "neither residual blocks, bins nor BatchNorm"),
        (network(config, critic_layer_norm=False), "critics need LayerNorm"),
        (dataclasses.replace(config, sac=dataclasses.replace(config.sac, weight_decay=0.1)), "no --sac.weight-decay"),
        (dataclasses.replace(config, sac=sac), "a batch of 490 is not a multiple of 16"),
    ):
        assert words in (why_not(SacLearner, changed) or "")
    assert why_not(SacLearner, preset_config("halfcheetah-vel", "fast+wide")) is None
    assert why_not(SacLearner, preset_config("halfcheetah-vel", "smoke")) is None
