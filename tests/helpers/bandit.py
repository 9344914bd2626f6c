"""A bandit that trains in seconds, and single updates of it."""

from __future__ import annotations

import dataclasses

import jax

from ear_jax.config import Config, NetworkConfig
from ear_jax.learning.batch import Batch, Draws
from ear_jax.learning.sac import SacLearner
from ear_jax.methods import Sizes, find_method, make_agent
from ear_jax.process.runtime import compiler_options
from ear_jax.runs import training
from ear_jax.runs.training import Program
from tests.helpers.probe import Bandit


def bandit_program(agent: str = "ear", kind: type[Bandit] = Bandit, history: int = 1, **sac: object) -> Program:
    base = Config(kind.name, agent=agent)
    inferred = agent == "pearl"
    encoder = {"task_layers": 1, "task_width": 32} if inferred else {}
    config = dataclasses.replace(
        base,
        network=NetworkConfig(32, 1, 1, 1, initialiser="fan_in", history=history, **encoder),
        sac=dataclasses.replace(base.sac, **{"lr": 3e-3 if inferred else 1e-2, "batch_size": 64, "updates": 50, **sac}),
        # MAML has no more than one step to go by in an episode, and needs many of them.
        collect=dataclasses.replace(base.collect, envs=512 if agent == "maml" else 16, steps=2, pretrain_epochs=4),
        maml=dataclasses.replace(base.maml, inner_lr=0.01, max_divergence=0.02),
        replay=dataclasses.replace(base.replay, capacity=4000),
    )
    family = kind("native")
    family.history = history
    tasks = family.training_tasks()
    built = make_agent(Sizes(family.observation_size, 1, len(tasks)), config)
    learner = find_method(agent).learner(built, family, tasks.params, config)
    return Program(config, family, tasks, built, learner)


def begin(program: Program) -> training.TrainState:
    """A run whose replay holds what the untrained policy did."""

    def begun(key: jax.Array) -> training.TrainState:
        epochs = program.config.collect.pretrain_epochs
        return jax.lax.fori_loop(
            0, epochs, lambda _, state: training.collect(program, state)[0], training.init(program, key)
        )

    return jax.jit(begun, compiler_options=compiler_options())(jax.random.key(0))


def train_on(program: Program, state: training.TrainState, epochs: int) -> training.TrainState:
    def epoch(state: training.TrainState) -> training.TrainState:
        return training.learn(program, training.collect(program, state)[0])[0]

    def trained(state: training.TrainState) -> training.TrainState:
        return jax.lax.fori_loop(0, epochs, lambda _, state: epoch(state), state)

    return jax.jit(trained, compiler_options=compiler_options())(state)


def all_draws(learner: SacLearner, seed: int, updates: int) -> Draws:
    """What so many updates draw, each leaf [updates, …]; compiled as one program, where op by op takes far longer."""
    return jax.jit(learner.draw, static_argnums=1)(jax.random.key(seed), updates)


def draws_of(learner: SacLearner, seed: int) -> Draws:
    """What one update draws."""
    return jax.tree.map(lambda leaf: leaf[0], all_draws(learner, seed, 1))


def batch_of(learner: SacLearner, state: training.TrainState, draws: Draws) -> Batch:
    """What an update of those draws learns from."""
    return jax.jit(learner.batches.take)(state.replay, draws)


def one_update(program: Program, state: training.TrainState, **changes: object):
    draws = draws_of(program.learner, 1)
    learner = dataclasses.replace(state.learner, **changes)
    update = jax.jit(program.learner.update, compiler_options=compiler_options())
    return learner, *update(learner, state.replay, draws)
