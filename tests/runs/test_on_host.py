"""Collection on the host beside learning on another device, with the processor as both."""

from __future__ import annotations

import dataclasses
import threading

import jax
import numpy as np
import pytest

from ear_jax.cli.main import main
from ear_jax.errors import RunError, UsageError
from ear_jax.presets import preset_config
from ear_jax.process.target import tracing_for
from ear_jax.runs import training
from ear_jax.runs.compiled import fill_replay, train_epochs
from ear_jax.runs.estimate import Times, times
from ear_jax.runs.fastest import fastest_engine, step_seconds
from ear_jax.runs.on_host import collects_on_host, compile_on_host
from tests.helpers.runs import compiled, leaves, tiny_config, words

EPOCHS = 3


def overlapping(config):
    return dataclasses.replace(config, collect=dataclasses.replace(config.collect, overlap=True))


@pytest.fixture(scope="module")
def on_host():
    """The tiny run with two seeds, collected on the host."""
    program = training.make_program(overlapping(tiny_config(seeds=2)))
    return compile_on_host(program, training.seed_keys(program.config))


@pytest.fixture(scope="module")
def filled(on_host):
    return fill_replay(on_host, on_host.init(training.seed_keys(tiny_config(seeds=2))), 2)


def fresh(state):
    """A copy of a state, as programs use up the one they are given."""
    return jax.tree.map(lambda leaf: leaf.copy(), state)


def test_without_overlap_it_is_the_training_of_one_device(on_host, filled):
    """The same data in the same order: states agree up to the rounding of programs that are compiled apart."""
    one = compiled(tiny_config(seeds=2))
    expected = fill_replay(one, one.init(training.seed_keys(tiny_config(seeds=2))), 2)
    alone, wanted = train_epochs(one, expected, EPOCHS)
    apart, found = train_epochs(dataclasses.replace(on_host, both=None), fresh(filled), EPOCHS)
    for a, b in zip(leaves(alone), leaves(apart), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-5)
    assert wanted[-1].keys() == found[-1].keys()


def test_with_overlap_an_epoch_is_collected_by_the_policy_before_its_updates(on_host, filled):
    """The data of the first epoch are those without overlap, and its updates do not see them."""
    apart, _ = on_host.collect(fresh(filled))
    later, metrics = on_host.both(fresh(filled))
    for a, b in zip(leaves(apart.replay), leaves(later.replay), strict=True):
        np.testing.assert_array_equal(a, b)
    blind, _ = on_host.learn(dataclasses.replace(fresh(filled), key=later_key(filled)))
    for a, b in zip(leaves(blind.learner), leaves(later.learner), strict=True):
        np.testing.assert_array_equal(a, b)
    assert (int(later.epoch[0]), int(later.collected[0])) == (1, 3)
    assert metrics.keys() >= {"invalid_steps", "critic_loss", "finite_updates"}
    np.testing.assert_array_equal(jax.random.key_data(blind.key), jax.random.key_data(later.key))


def test_with_overlap_updates_begin_before_collection_ends(on_host, filled):
    """Collection waits for the updates here, and would for ever if they came after it."""
    parts, begun = on_host.both.__self__, threading.Event()

    def explore(*arguments):
        assert begun.wait(60), "updates wait for collection"
        return parts.explore(*arguments)

    def learn(state):
        begun.set()
        return parts.learn(state)

    later, _ = dataclasses.replace(parts, explore=explore, learn=learn).overlapped(fresh(filled))
    assert int(later.epoch[0]) == 1


def later_key(state):
    """The key of a state after its collection."""
    return jax.vmap(lambda key: jax.random.split(key)[1])(state.key)


def test_evaluation_on_the_host_plays_as_on_the_device(on_host, filled):
    keys = training.evaluation_keys(training.seed_keys(tiny_config(seeds=2)), 1)
    there, here = (
        on_host.evaluate(filled.learner.policy, keys),
        compiled(tiny_config(seeds=2)).evaluate(filled.learner.policy, keys),
    )
    np.testing.assert_allclose(there.returns, here.returns, rtol=1e-4)


def test_overlap_needs_native_and_replay():
    assert collects_on_host(training.make_program(overlapping(tiny_config())))
    assert not collects_on_host(training.make_program(tiny_config()))
    with pytest.raises(UsageError, match="needs --engine native"):
        collects_on_host(training.make_program(overlapping(preset_config("halfcheetah-vel", "smoke", "maml"))))


def test_on_an_accelerator_a_method_without_replay_needs_mjx(monkeypatch):
    monkeypatch.setattr("ear_jax.runs.on_host.on_accelerator", lambda: True)
    with pytest.raises(UsageError, match="--engine native cannot train agent maml on an accelerator; use mjx"):
        collects_on_host(training.make_program(preset_config("halfcheetah-vel", "smoke", "maml")))


def test_the_faster_engine_is_taken_and_told():
    seconds = step_seconds(tiny_config(), "native")
    assert 0 < seconds < 1
    engine, line = fastest_engine({"native": 0.002, "mjx": 0.001})
    assert (engine, line) == ("mjx", "engine mjx: a step of all environments takes native 2.00 ms, mjx 1.00 ms")


def test_an_estimate_for_an_accelerator_times_collection_on_the_host(on_host, monkeypatch):
    """With engine native; what is compiled for the processor stands for both devices."""
    asked = []

    def compile_on_host(program, keys):
        asked.append((program.family.engine.name, len(keys)))
        return dataclasses.replace(on_host, both=None)

    monkeypatch.setattr("ear_jax.runs.on_host.on_accelerator", lambda: True)
    monkeypatch.setattr("ear_jax.runs.on_host.compile_on_host", compile_on_host)
    taken = times(tiny_config(seeds=2))
    assert asked == [("native", 2)]
    assert 0 < taken.epoch < taken.compiling
    assert taken.evaluation > 0


def test_a_dry_run_names_the_engine_that_auto_means_on_an_accelerator(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("ear_jax.runs.fastest.on_accelerator", lambda: True)
    monkeypatch.setattr(
        "ear_jax.runs.fastest.step_seconds", lambda config, engine: {"native": 1e-3, "mjx": 2e-3}[engine]
    )
    monkeypatch.setattr("ear_jax.runs.estimate.times", lambda config: Times(10.0, 1.0, 1.0))
    run = tmp_path / "run"
    assert main([*words(dataclasses.replace(tiny_config(), engine="auto")), "--out", str(run), "--dry-run"]) == 0
    out, err = capsys.readouterr()
    assert "engine native: a step of all environments takes native 1.00 ms, mjx 2.00 ms" in err
    assert "engine native on" in out
    assert not run.exists()


def test_native_cannot_be_compiled_for_an_accelerator():
    family = training.make_program(tiny_config()).family
    state = family.reset(jax.random.key(0))
    with (
        tracing_for("gpu"),
        pytest.raises(RunError, match="steps on the CPU, but JAX runs on cpu here"),
    ):
        jax.eval_shape(family.step, state, np.zeros(6))
