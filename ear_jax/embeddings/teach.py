"""Teaching a policy to play its schedules of LTEs under each task's own LTE.

Ross et al. 2011 (DAgger, arXiv 1011.0686): the student plays, the teacher says what it would have done in the states
where the student came, and the student learns from all that was said so far.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import optax
from flax import struct

from ear_jax.agents import Agent
from ear_jax.agents.networks import Params
from ear_jax.agents.tanh_gaussian import Gaussian, squash
from ear_jax.embeddings.schedule import constant, in_time, pushed
from ear_jax.envs.batched_env import BatchedEnv, Transition
from ear_jax.learning.episodes import starts
from ear_jax.learning.rollout import first_episode, rollout
from ear_jax.runs.training import Program

NOISES = (0.0, 0.5)  # shares of the policy's σ with which lessons are played
ACTION_SCALE, LOG_STD_SCALE = 0.2, 4.0  # differences that cost 1


@dataclass(frozen=True)
class Teaching:
    """Settings of teaching."""

    passes: int = 3  # of playing lessons and learning; the teacher plays the first, the student the others
    episodes: int = 8  # a task, pass and share of noise
    updates: int = 600  # gradient steps a pass
    batch: int = 1024
    lr: float = 3e-4  # falls to 0 over all passes
    elsewhere: float = 0.1  # weight of staying as before under codes all over the sphere

    def all_episodes(self, tasks: int) -> int:
        """Returns the episodes of a pass."""
        return len(NOISES) * self.episodes * tasks


@struct.dataclass
class Lessons:
    """States, the teacher's distribution of actions there and whether it counts, each leaf [n, …]."""

    obs: jax.Array
    task: jax.Array  # int32
    taught: Gaussian
    valid: jax.Array  # bool; False past the end of an episode


@struct.dataclass
class Student:
    """A policy that is being taught."""

    policy: Params
    optimiser: Any
    lessons: Lessons  # room for those of all passes
    filled: jax.Array  # int32, the number of lessons so far


def difference(student: Gaussian, teacher: Gaussian) -> jax.Array:
    """Returns how far two distributions are apart: mean squares of differences of tanh(mean) and of log σ."""
    action = (jnp.tanh(student.mean) - jnp.tanh(teacher.mean)) / ACTION_SCALE
    log_std = (student.log_std - teacher.log_std) / LOG_STD_SCALE
    return jnp.mean(action**2) + jnp.mean(log_std**2)


def enrol(program: Program, teaching: Teaching, teacher: Params) -> Student:
    """Returns a student that plays as its teacher does."""
    family, steps = program.family, program.family.episode_length
    count = teaching.passes * teaching.all_episodes(len(program.tasks)) * steps
    action = jnp.zeros((count, family.action_size))
    obs, task = jnp.zeros((count, family.observation_size)), jnp.zeros(count, jnp.int32)
    lessons = Lessons(obs, task, Gaussian(action, action), jnp.zeros(count, bool))
    return Student(teacher, _optimiser(teaching).init(teacher), lessons, jnp.int32(0))


def teach(
    program: Program, teaching: Teaching, teacher: Params, schedules: jax.Array, student: Student, key: jax.Array
) -> tuple[Student, jax.Array]:
    """Makes one pass with one seed's student.

    Args:
      program, teaching: the family, the agent and the settings.
      teacher: the parameters that act under the schedules.
      schedules: [tasks, pieces, code + act].
      student: its state; in its first pass it plays as the teacher.
      key: of starts, noise and batches.

    Returns:
      The student's state, and how far it is from the teacher, on average over the last tenth of its gradient steps.
    """
    key_play, key_learn = jax.random.split(key)
    own = constant(program.agent.codes(teacher), program.family.action_size)
    under = jnp.where(student.filled == 0, schedules, own)
    play = partial(_play, program, teacher, student.policy, under, schedules, teaching.episodes)
    lessons = jax.vmap(play)(jnp.array(NOISES), jax.random.split(key_play, len(NOISES)))
    said = jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), lessons)
    add = partial(jax.lax.dynamic_update_slice_in_dim, start_index=student.filled, axis=0)
    known = jax.tree.map(add, student.lessons, said)
    filled = student.filled + len(said.task)
    optimiser = _optimiser(teaching)

    def update(carry: tuple[Params, Any], key: jax.Array) -> tuple[tuple[Params, Any], jax.Array]:
        policy, state = carry
        key_item, key_code = jax.random.split(key)
        batch = jax.tree.map(lambda leaf: leaf[jax.random.randint(key_item, (teaching.batch,), 0, filled)], known)
        objective = partial(_objective, program.agent, teaching, teacher, batch, key_code)
        grad, apart = jax.grad(objective, has_aux=True)(policy)
        change, state = optimiser.update(grad, state, policy)
        return (optax.apply_updates(policy, change), state), apart

    keys = jax.random.split(key_learn, teaching.updates)
    (policy, state), apart = jax.lax.scan(update, (student.policy, student.optimiser), keys)
    return Student(policy, state, known, filled), apart[-max(1, len(apart) // 10) :].mean()


def _optimiser(teaching: Teaching) -> optax.GradientTransformation:
    return optax.adam(optax.cosine_decay_schedule(teaching.lr, teaching.passes * teaching.updates))


def _objective(
    agent: Agent, teaching: Teaching, teacher: Params, batch: Lessons, key: jax.Array, policy: Params
) -> tuple[jax.Array, jax.Array]:
    """Returns the loss, and how far the policy is from what it is taught."""
    distributions = jax.vmap(agent.distribution, (None, 0, 0))
    apart = jax.vmap(difference)(distributions(policy, agent.codes(teacher)[batch.task], batch.obs), batch.taught)
    apart = jnp.sum(jnp.where(batch.valid, apart, 0.0)) / jnp.maximum(jnp.sum(batch.valid), 1)
    obs = batch.obs[: teaching.batch // 4]
    codes = jax.vmap(agent.project)(jax.random.normal(key, (len(obs), agent.code_size)))
    changed = jax.vmap(difference)(distributions(policy, codes, obs), distributions(teacher, codes, obs))
    return apart + teaching.elsewhere * jnp.mean(changed), apart


def _play(
    program: Program,
    teacher: Params,
    actor: Params,
    under: jax.Array,
    schedules: jax.Array,
    episodes: int,
    noise: jax.Array,
    key: jax.Array,
) -> Lessons:
    """Plays one seed under some schedules [tasks, pieces, code + act]; the teacher says what it does under others."""
    family, agent, steps = program.family, program.agent, program.family.episode_length
    tasks, size = len(program.tasks), schedules.shape[-1]
    key_start, key_noise = jax.random.split(key)
    explore = noise * jax.random.normal(key_noise, (steps, tasks, episodes, family.action_size))
    acting, teaching = (
        jnp.broadcast_to(in_time(pieces, steps)[:, :, None], (steps, tasks, episodes, size))
        for pieces in (under, schedules)
    )

    def act(obs: jax.Array, inputs: jax.Array) -> jax.Array:
        return squash(pushed(agent, actor, inputs[:size], obs), inputs[size:])

    def record(step: Transition) -> tuple[jax.Array, jax.Array]:
        return step.obs, step.terminated | ~step.valid

    begun = starts(family, program.tasks.params, key_start, episodes)
    inputs = jnp.concatenate([acting, explore], axis=-1)
    _, (obs, over) = rollout(BatchedEnv(family, resets=False), jax.vmap(jax.vmap(act)), begun, inputs, record)
    taught = jax.vmap(jax.vmap(jax.vmap(partial(pushed, agent, teacher))))(teaching, obs)
    task = jnp.broadcast_to(jnp.arange(tasks)[:, None], over.shape)
    lessons = Lessons(obs, task, taught, first_episode(over))
    return jax.tree.map(lambda leaf: leaf.reshape(over.size, *leaf.shape[3:]), lessons)
