"""The training program: pure functions of one seed, which the host loop compiles."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from ear_jax.agents import Agent
from ear_jax.agents.equivariant import equivariant
from ear_jax.agents.networks import Params
from ear_jax.config import Config
from ear_jax.envs import FAMILIES, Family, find_task, make_family, spread_tasks
from ear_jax.envs.batched_env import BatchedEnv, EnvState
from ear_jax.envs.signature import Signature, signature_of
from ear_jax.errors import UsageError
from ear_jax.learning.batch import drawn_tasks
from ear_jax.learning.episodes import Episodes, play_from, starts
from ear_jax.learning.learner import Learner, Metrics
from ear_jax.limits import check
from ear_jax.methods import Sizes, find_method, make_agent
from ear_jax.process.environment import check_settings
from ear_jax.tasks import TaskSet, task_set

Numbers = Mapping[str, jax.Array]  # settings by name, such as sac.lr, that are arguments of the compiled program
EVALUATION_STREAM = 0x0E7A1  # keeps the keys of evaluation apart from those of training


@struct.dataclass
class TrainState:
    """The state of one seed's run; resuming from it gives the same results as never stopping."""

    learner: Any  # SacState or MamlState
    replay: Any  # Replay, or the last epoch's Trials for an on-policy learner
    cells: EnvState  # the environments, [tasks, envs]; checkpoints store leaves by this name
    key: jax.Array  # of all later randomness
    epoch: jax.Array  # int32, epochs trained
    collected: jax.Array  # int32, epochs of collection, including those without updates

    @property
    def without_replay(self) -> TrainState:
        """The state without its replay, which is by far the largest part."""
        return replace(self, replay=None)


@dataclass(frozen=True, eq=False)
class Program:
    """A configuration with the family, agent and learner it names.

    A program equals itself only, so that functions compiled for it can be kept by it.
    """

    config: Config
    family: Family
    tasks: TaskSet
    agent: Agent  # acts in float32, whatever `network.matmul` is
    learner: Learner

    @property
    def env_steps_per_epoch(self) -> int:
        """Environment steps of one seed in an epoch."""
        collect, tasks = self.config.collect, len(self.tasks)
        on_policy = find_method(self.config.agent).learner.on_policy
        played = drawn_tasks(self.config, tasks) if on_policy else tasks
        return played * collect.envs * collect.steps

    def env_steps(self, collected: int) -> int:
        """Returns the environment steps of one seed in a number of epochs of collection."""
        return self.env_steps_per_epoch * collected

    @functools.cached_property
    def signature(self) -> Signature | None:
        """Numbers by which the code of a user's family is recognised; None for a family that ships."""
        return None if self.config.family in FAMILIES else signature_of(self.family, self.tasks)


def make_program(config: Config) -> Program:
    """Checks a configuration and builds its program; nothing is compiled.

    Raises:
      UsageError: a name or value is invalid.
      RunError: the engine cannot run here, or JAX has a setting that would leak into the run.
    """
    check_settings()
    check(config)
    family = _family(config)
    tasks = _tasks(config, family)
    method = find_method(config.agent)
    method.check(config)
    method.learner.check(config, len(tasks))
    if config.replay.symmetry and family.symmetry is None:
        raise UsageError(f"--replay.symmetry True would change nothing: {family.name} has no symmetry")
    if config.network.equivariant and family.symmetry is None:
        raise UsageError(f"--network.equivariant True would change nothing: {family.name} has no symmetry")
    if config.network.equivariant and method.reads("network.lte_size") and config.network.lte_size < 2:
        raise UsageError("--network.equivariant True turns the first two numbers of an LTE; --network.lte-size is 1")
    float32 = replace(config, network=replace(config.network, matmul="float32"))
    return Program(config, family, tasks, _agent(float32, family, tasks), _learner(config, family, tasks))


def family_with(program: Program, options: Mapping[str, Any]) -> Family:
    """Returns a program's family with some of its options changed.

    Raises:
      UsageError: the family does not have an option, or its value is out of range.
    """
    if not options:
        return program.family
    config = replace(program.config, env=replace(program.config.env, **options))
    check(config)
    return _family(config)


def with_numbers(program: Program, numbers: Numbers) -> Program:
    """Returns the program with some of the learner's settings replaced by scalars."""
    if not numbers:
        return program
    config = program.config
    for name, number in numbers.items():
        group, _, setting = name.partition(".")
        config = replace(config, **{group: replace(getattr(config, group), **{setting: number})})
    return replace(program, config=config, learner=_learner(config, program.family, program.tasks))


def _family(config: Config) -> Family:
    family = make_family(config.family, config.engine, **dataclasses.asdict(config.env))
    family.history = config.network.history
    return family


def _tasks(config: Config, family: Family) -> TaskSet:
    if config.tasks:
        return task_set([find_task(family, name) for name in config.tasks])
    return spread_tasks(family, config.task_count) if config.task_count else family.training_tasks()


def _learner(config: Config, family: Family, tasks: TaskSet) -> Learner:
    return find_method(config.agent).learner(_agent(config, family, tasks), family, tasks.params, config)


def _agent(config: Config, family: Family, tasks: TaskSet) -> Agent:
    sizes = Sizes(family.observation_size, family.action_size, len(tasks), len(family.outcome_shapes))
    agent = make_agent(sizes, config)
    symmetry = family.symmetry if config.network.equivariant else None
    if symmetry is None:
        return agent
    with jax.ensure_compile_time_eval():  # a sweep makes its agents while it is traced
        return equivariant(agent, symmetry, tasks.params)


def seed_keys(config: Config) -> jax.Array:
    """Returns each seed's initial key, [seeds]."""
    return jax.vmap(jax.random.key)(config.seed + jnp.arange(config.seeds))


def evaluation_keys(keys: jax.Array, number: int) -> jax.Array:
    """Derives each seed's key for an evaluation, unused by training, from its initial key [seeds]."""
    return jax.vmap(lambda key: jax.random.fold_in(jax.random.fold_in(key, EVALUATION_STREAM), number))(keys)


def init(program: Program, key: jax.Array) -> TrainState:
    """Returns the initial state of one seed."""
    key_learner, key_cells, key_run = jax.random.split(key, 3)
    collect = program.config.collect
    env_states = BatchedEnv(program.family).start(key_cells, program.tasks.params, collect.envs, collect.stagger)
    return TrainState(
        learner=program.learner.init(key_learner),
        replay=program.learner.memory(env_states),
        cells=env_states,
        key=key_run,
        epoch=jnp.int32(0),
        collected=jnp.int32(0),
    )


def collect(program: Program, state: TrainState) -> tuple[TrainState, Metrics]:
    """Runs one seed's collection for an epoch.

    It also fills the replay before the first update, with the untrained policy (algorithm 1, pre-train epochs).
    """
    key, later = jax.random.split(state.key)
    env_states, memory, metrics = program.learner.collect(state.learner, state.replay, state.cells, key)
    return replace(state, cells=env_states, replay=memory, key=later, collected=state.collected + 1), metrics


def learn(program: Program, state: TrainState) -> tuple[TrainState, Metrics]:
    """Runs one seed's updates for an epoch; the metrics are the learner's and the final norms."""
    key, later = jax.random.split(state.key)
    learner, metrics = program.learner.learn(state.learner, state.replay, key)
    return replace(state, learner=learner, key=later, epoch=state.epoch + 1), {**metrics, **learner.norms}


def evaluate(program: Program, policy: Params, key: jax.Array, episodes: int) -> Episodes:
    """Plays one seed's policy on the training tasks without exploration, [tasks, episodes]."""
    return evaluate_from(program, policy, evaluation_starts(program, key, episodes))


def evaluation_starts(program: Program, key: jax.Array, episodes: int) -> EnvState:
    """Draws the starts of `evaluate`, [tasks, episodes]."""
    return starts(program.family, program.tasks.params, key, episodes)


def evaluate_from(program: Program, policy: Params, env_states: EnvState) -> Episodes:
    """Plays one seed's policy as `evaluate` does, from given starts [tasks, episodes]."""
    family, (rows, episodes) = program.family, env_states.steps.shape
    noise = jnp.zeros((family.episode_length, rows, episodes, family.action_size))
    codes = program.agent.codes(policy)
    return play_from(family, program.agent, policy, codes, program.tasks.params, env_states, noise)
