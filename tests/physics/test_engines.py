"""A policy does the same on every engine. Compiling MJX takes minutes, so these tests are slow."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ear_jax.agents.tanh_gaussian import Gaussian
from ear_jax.cli.main import main
from ear_jax.embeddings.evaluate import Episodes, play
from ear_jax.envs import FAMILIES
from ear_jax.presets import preset_config
from ear_jax.runs.loop import train_run
from ear_jax.runs.trained import load
from ear_jax.runs.training import make_program
from tests.helpers.runs import last_state, leaves, words

EPISODES = 64
pytestmark = pytest.mark.slow


def play_linear(family: str, engine: str) -> Episodes:
    """Plays two tasks under one fixed policy: tanh of random sums of observations."""
    program = make_program(dataclasses.replace(preset_config(family, "smoke"), engine=engine))
    weights = 0.3 * jax.random.normal(jax.random.key(1), (program.family.action_size, program.family.observation_size))
    linear = dataclasses.replace(
        program.agent, distribution=lambda policy, code, obs: Gaussian(policy @ obs, jnp.zeros(len(policy)))
    )
    tasks = jax.tree.map(lambda leaf: leaf[:2], program.tasks.params)
    codes = jnp.zeros((2, linear.code_size))
    return jax.jit(lambda key: play(program.family, linear, weights, codes, tasks, key, EPISODES))(jax.random.key(2))


@pytest.mark.parametrize("family", [name for name in FAMILIES if name != "reach"])  # see test_reach.py
def test_whole_episodes_return_alike_on_mjx_and_native(family):
    """Single episodes from the same starts differ after a few contacts; their means agree within 3 standard errors."""
    native, mjx = (play_linear(family, engine) for engine in ("native", "mjx"))
    gap = np.mean(mjx.returns - native.returns, axis=1)
    error = np.sqrt((np.var(mjx.returns, axis=1) + np.var(native.returns, axis=1)) / EPISODES)
    assert (np.std(native.returns, axis=1) > 0).all(), "every episode the same"
    assert (np.abs(gap) < 3 * error).all(), f"gap {gap}, standard error {error}"
    assert abs(np.mean(mjx.lengths) - np.mean(native.lengths)) < 0.1 * np.mean(native.lengths)


def test_a_run_continues_and_is_evaluated_on_another_engine(tiny, run_directory, capsys):
    train_run(dataclasses.replace(tiny, epochs=2), run_directory)
    before = leaves(last_state(run_directory, tiny).replay)
    assert main([*words(dataclasses.replace(tiny, engine="mjx")), "--out", str(run_directory)]) == 0
    assert "engine native" in capsys.readouterr().err
    after = leaves(last_state(run_directory, tiny).replay)
    kept = int(before[-1].min())  # transitions in a ring, collected on native: they stay, and more are added
    assert all((one[:, :, :kept] == two[:, :, :kept]).all() for one, two in zip(before[:-1], after[:-1], strict=True))
    assert (after[-1] > before[-1]).all()
    trained = load(run_directory, engine="native")
    assert (trained.epoch, trained.program.family.engine.name) == (4, "native")
    assert load(run_directory).program.family.engine.name == "mjx"
    assert main(["evaluate", str(run_directory), "--engine", "native", "--episodes", "1", "--json"]) == 0
    assert '"engine": "native"' in capsys.readouterr().out
