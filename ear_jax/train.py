"""The training program: what is compiled, and nothing that touches the host."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
from flax import struct

from ear_jax import replay
from ear_jax.agents import Agent, make_agent
from ear_jax.config import Config, check
from ear_jax.envs import Family, find_task, make_family
from ear_jax.grid import Cell, Grid, Transition
from ear_jax.learner import Learner, LearnerState
from ear_jax.replay import Experience, Replay
from ear_jax.rollout import act_with, rollout
from ear_jax.tasks import TaskSet, task_set

Metrics = dict[str, jax.Array]
EVALUATION_STREAM = 0x0E7A1  # keeps the keys of evaluation apart from those of training


@struct.dataclass
class TrainState:
    """The whole run of one seed: stopping and resuming from it equals never stopping."""

    learner: LearnerState
    replay: Replay
    cells: Cell  # the environments, [tasks, envs]
    key: jax.Array
    epoch: jax.Array  # int32, epochs trained
    collected: jax.Array  # int32, epochs of collection, those without updates included

    @property
    def without_replay(self) -> TrainState:
        """All but what the replay holds, which is most of it."""
        return replace(self, replay=None)  # type: ignore[arg-type]


@dataclass(frozen=True)
class Program:
    """A configuration made ready: the family on its engine, the agent, the learner."""

    config: Config
    family: Family
    tasks: TaskSet
    agent: Agent
    learner: Learner

    @property
    def env_steps_per_epoch(self) -> int:
        return len(self.tasks) * self.config.collect.envs * self.config.collect.steps

    def env_steps(self, collected: int) -> int:
        """Environment steps of one seed in so many epochs of collection."""
        return self.env_steps_per_epoch * collected


def make_program(config: Config) -> Program:
    """Checks a configuration and builds what it names; nothing is compiled.

    Raises:
      UsageError: a name or value that makes no sense.
      RunError: the engine cannot run here.
    """
    family = make_family(config.family, config.engine, **dataclasses.asdict(config.env))
    family.history = config.network.history
    tasks = task_set([find_task(family, name) for name in config.tasks]) if config.tasks else family.training_tasks()
    check(config, len(tasks))
    sizes = (family.observation_size, family.action_size, len(tasks))
    agent = make_agent(config.agent, *sizes, config.network, config.sac.lte_noise)
    return Program(config, family, tasks, agent, Learner(agent, family, tasks.params, config))


def seed_keys(config: Config) -> jax.Array:
    """The key each seed starts from, [seeds]."""
    return jax.vmap(jax.random.key)(config.seed + jnp.arange(config.seeds))


def evaluation_keys(keys: jax.Array, number: int) -> jax.Array:
    """Keys for an evaluation of each seed that no training step has used; keys [seeds]."""
    return jax.vmap(lambda key: jax.random.fold_in(jax.random.fold_in(key, EVALUATION_STREAM), number))(keys)


def init(program: Program, key: jax.Array) -> TrainState:
    """A fresh run of one seed."""
    key_learner, key_cells, key_run = jax.random.split(key, 3)
    config, family = program.config, program.family
    collect = config.collect
    cells = Grid(family).start(key_cells, program.tasks.params, collect.envs, collect.stagger)
    obs = jnp.zeros(family.observation_size)
    outcome = jax.tree.map(lambda leaf: leaf[0, 0], cells.state.metrics)
    item = Experience(obs, jnp.zeros(family.action_size), obs, outcome, jnp.zeros((), bool))
    return TrainState(
        learner=program.learner.init(key_learner),
        replay=replay.init(item, len(program.tasks), config.replay.capacity // len(program.tasks)),
        cells=cells,
        key=key_run,
        epoch=jnp.int32(0),
        collected=jnp.int32(0),
    )


def collect(program: Program, state: TrainState) -> tuple[TrainState, Metrics]:
    """One epoch's collection of one seed: every task's environments act under its own code, into its own ring.

    Also what fills the replay before the first update, by the untrained policy (algorithm 1, the pre-train epochs).
    """
    key, later = jax.random.split(state.key)
    settings, family = program.config.collect, program.family
    shape = (settings.steps, len(program.tasks), settings.envs, family.action_size)
    policy = state.learner.policy
    act = act_with(program.agent, policy, program.learner.codes_to_act(policy, state.replay, key))
    noise = jax.random.normal(key, shape)
    cells, transitions = rollout(Grid(family), act, state.cells, noise, _whole)
    invalid = jnp.sum(~transitions.valid, dtype=jnp.float32)
    buffer = replay.add(state.replay, transitions)
    state = replace(state, cells=cells, replay=buffer, key=later, collected=state.collected + 1)
    return state, {"invalid_steps": invalid}


def learn(program: Program, state: TrainState) -> tuple[TrainState, Metrics]:
    """One epoch's updates of one seed.

    Returns:
      The run afterwards, and its metrics: scalars averaged over the updates, norms at their end, and `sound_updates`
      [tasks], the updates before the first in which a task's loss was not finite.
    """
    key, later = jax.random.split(state.key)
    learner = program.learner.observe(state.learner, state.replay)
    learner, watched = jax.lax.scan(
        lambda learner, draws: program.learner.update(learner, state.replay, draws),
        learner,
        program.learner.draw(key, program.config.sac.updates),
    )
    sound = jnp.sum(jnp.cumprod(watched.pop("sound"), axis=0), axis=0)  # from [updates, tasks]
    state = replace(state, learner=learner, key=later, epoch=state.epoch + 1)
    return state, {**jax.tree.map(jnp.mean, watched), **learner.norms, "sound_updates": sound}


def _whole(transition: Transition) -> Transition:
    return transition
