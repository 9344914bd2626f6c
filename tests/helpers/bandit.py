"""A bandit that trains in seconds, and single updates of it.

Compiling is most of what a bandit costs, so a program is made and compiled once in a process. A test that patches what
is compiled takes an `uncompiled` one.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from functools import partial
from typing import Any

import jax

from ear_jax.agents.networks import Params
from ear_jax.config import Config, NetworkConfig
from ear_jax.learning.batch import Batch, Draws
from ear_jax.learning.episodes import Episodes
from ear_jax.learning.sac import SacLearner
from ear_jax.methods import Sizes, find_method, make_agent
from ear_jax.runs import training
from ear_jax.runs.training import Program, TrainState
from tests.helpers.probe import Bandit

UPDATES = 50  # an epoch


@functools.cache
def bandit_program(agent: str = "ear", kind: type[Bandit] = Bandit, history: int = 1, **sac: object) -> Program:
    base = Config(kind.name, agent=agent)
    inferred = agent == "pearl"
    encoder = {"task_layers": 1, "task_width": 32} if inferred else {}
    settings = {"lr": 3e-3 if inferred else 1e-2, "batch_size": 64, "updates": UPDATES, **sac}
    config = dataclasses.replace(
        base,
        network=NetworkConfig(32, 1, 1, 1, initialiser="fan_in", history=history, **encoder),
        sac=dataclasses.replace(base.sac, **settings),
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


class Parts:
    """The parts of a program's training, each compiled when it is first called."""

    def __init__(self, program: Program):
        self.program = program
        self.init = jax.jit(partial(training.init, program))
        self.collect = jax.jit(lambda state: training.collect(program, state)[0])
        self.learn = jax.jit(lambda state: training.learn(program, state)[0])
        self.evaluate = jax.jit(partial(training.evaluate, program), static_argnums=2)

    @functools.cached_property
    def begun(self) -> TrainState:
        state = self.init(jax.random.key(0))
        for _ in range(self.program.config.collect.pretrain_epochs):
            state = self.collect(state)
        return state


_parts: dict[int, Parts] = {}  # by the identity of their program: it holds arrays, so it has no hash
_functions: dict[tuple[int, str], tuple[SacLearner, Any]] = {}  # the same of learners


def parts(program: Program) -> Parts:
    return _parts.setdefault(id(program), Parts(program))


def compiled(learner: SacLearner, name: str, function: Callable[..., Any], **options: Any) -> Callable[..., Any]:
    """Returns a function of a learner, compiled once."""
    return _functions.setdefault((id(learner), name), (learner, jax.jit(function, **options)))[1]


def uncompiled(program: Program) -> Program:
    """Returns a copy that is compiled again, for a test that has patched a part of it."""
    return dataclasses.replace(program, learner=dataclasses.replace(program.learner))


def begin(program: Program) -> TrainState:
    """Returns a run whose replay holds what the untrained policy did."""
    return parts(program).begun


def train_on(program: Program, state: TrainState, epochs: int) -> TrainState:
    for _ in range(epochs):
        state = parts(program).learn(parts(program).collect(state))
    return state


def played(program: Program, policy: Params, episodes: int) -> Episodes:
    """Plays a policy on the training tasks, [tasks, episodes]."""
    return parts(program).evaluate(policy, jax.random.key(2), episodes)


def all_draws(learner: SacLearner, seed: int, updates: int) -> Draws:
    """Returns the randomness of `updates` updates, each leaf [updates, …]."""
    return compiled(learner, "draw", learner.draw, static_argnums=1)(jax.random.key(seed), updates)


def draws_of(learner: SacLearner, seed: int) -> Draws:
    """Returns the randomness of one update."""
    return jax.tree.map(lambda leaf: leaf[0], all_draws(learner, seed, 1))


def batch_of(learner: SacLearner, state: TrainState, draws: Draws) -> Batch:
    """Returns the batch that an update of those draws learns from."""
    return compiled(learner, "take", learner.batches.take)(state.replay, draws)


def target_of(learner: SacLearner, state: TrainState, batch: Batch, draws: Draws) -> jax.Array:
    """Returns the target of a batch's critics."""
    table = learner.agent.codes(state.learner.policy)
    return compiled(learner, "target", learner._target)(state.learner, batch, table, draws.next)[-1]


def one_update(program: Program, state: TrainState, **changes: object):
    """Makes one update of a state with some parts changed; returns the state before, the state after and metrics."""
    learner = dataclasses.replace(state.learner, **changes)
    update = compiled(program.learner, "update", program.learner.update)
    return learner, *update(learner, state.replay, draws_of(program.learner, 1))
