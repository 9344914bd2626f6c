"""Traced functions of benchmarks, traced or run in small so that one that no longer fits the package is noticed."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import jax
import numpy as np
import pytest

from benchmarks import adaptation, chunk, matmul, physics, update
from ear_jax.envs import make_family
from ear_jax.envs.batched_env import Transition
from ear_jax.presets import preset_config
from ear_jax.runs import training
from ear_jax.runs.trained import load

SMOKE = preset_config("halfcheetah-vel", "smoke")


@pytest.fixture(scope="module")
def program():
    return training.make_program(SMOKE)


@pytest.fixture(scope="module")
def state(program):
    """A filled state of one seed, its shapes only."""
    return jax.eval_shape(partial(update.filled, program), jax.random.key(0))


def shapes(tree):
    return jax.tree.map(lambda leaf: (leaf.shape, leaf.dtype), tree)


def test_collection_of_an_epoch(program, state):
    transitions = jax.eval_shape(partial(chunk.collect, program), state)
    assert isinstance(transitions, Transition)
    settings = SMOKE.collect
    assert transitions.action.shape[:3] == (settings.steps, len(program.tasks), settings.envs)


def test_updates_of_an_epoch_return_the_learner(program, state):
    learner = jax.eval_shape(partial(chunk.update, program), state)
    assert shapes(learner) == shapes(state.learner)


@pytest.mark.parametrize("precision", ["float32", "bfloat16"])
def test_updates_alone_return_the_learner(precision, state):
    program = training.make_program(matmul.with_matmul(SMOKE, precision))
    learner = jax.eval_shape(partial(update.updated, program, 2), state.learner, state.replay, state.key)
    assert shapes(learner) == shapes(state.learner)


def test_the_matmuls_of_an_update_are_found_and_multiplied(program):
    state = jax.eval_shape(jax.vmap(partial(update.filled, program)), training.seed_keys(SMOKE))
    found = list(update.find_matmuls(jax.make_jaxpr(partial(update._first_update, program))(state).jaxpr))
    assert found
    assert all(one.flop > 0 for one in found)
    update.matmul_run(found[:1], 1)()


def test_an_engine_plays_a_case():
    family = make_family("halfcheetah-vel", "native")
    model, batch = family.model, 10
    sizes = ((batch, model.nq), (batch, model.nv), (batch, model.nv), (1, batch, model.nu))
    physics.engine_run(family, physics.Case(family.name, *(np.zeros(size, np.float32) for size in sizes)))()


def test_the_loop_over_candidates_plays_them():
    assert adaptation.loop_steps_per_second(load(Path(adaptation.RUN)), 1) > 0
