"""Schedules of LTEs: an episode in pieces, each under an LTE of its own, searched by the cross-entropy method.

An episode often returns more if it begins under other LTEs than its task's: what one task has learnt, another can use.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from ear_jax.agents.networks import Params
from ear_jax.embeddings.codes import Project
from ear_jax.envs.batched_env import BatchedEnv, Transition
from ear_jax.learning.episodes import starts
from ear_jax.learning.rollout import act_along, first_episode, rollout, score
from ear_jax.runs.training import Program

BEGINS = (0.0, 0.05, 0.1, 0.2, 0.4)  # shares of an episode at which its pieces begin
SLOWNESS = 0.3  # share of a standard deviation that the next epoch keeps


@dataclass(frozen=True)
class ScheduleSearch:
    """Settings of the search."""

    epochs: int = 12
    candidates: int = 32  # schedules a task and epoch
    starts: int = 3  # random starts that each is played from
    elites: int = 5
    sigma: float = 0.35  # standard deviation of an LTE's coordinates in the first epoch

    def episodes(self, tasks: int) -> int:
        """Returns the episodes of a whole search."""
        return self.epochs * self.candidates * self.starts * tasks


@struct.dataclass
class Schedules:
    """The state of a search: the schedules around which the next candidates are drawn."""

    codes: jax.Array  # [tasks, pieces, code]
    sigma: jax.Array  # as `codes`, standard deviations


def init(codes: jax.Array, sigma: float) -> Schedules:
    """Returns schedules that stay at each task's own code, given the table [tasks, code]."""
    schedules = jnp.repeat(codes[:, None], len(BEGINS), axis=1)
    return Schedules(schedules, jnp.full(schedules.shape, sigma))


def ask(state: Schedules, key: jax.Array, count: int, project: Project) -> jax.Array:
    """Returns candidates [tasks, count, pieces, code], of which each task's first is the mean."""
    tasks, *shape = state.codes.shape
    noise = jax.random.normal(key, (tasks, count, *shape)).at[:, 0].set(0.0)
    return on_sphere(state.codes[:, None] + state.sigma[:, None] * noise, project)


def tell(state: Schedules, candidates: jax.Array, returns: jax.Array, elites: int, project: Project) -> Schedules:
    """Moves each task's schedule to the mean of the best candidates, given their returns [tasks, count]."""
    _, best = jax.lax.top_k(returns, elites)
    chosen = jax.vmap(lambda rows, index: rows[index])(candidates, best)
    sigma = (1 - SLOWNESS) * chosen.std(axis=1) + SLOWNESS * state.sigma
    return Schedules(on_sphere(chosen.mean(axis=1), project), sigma)


def on_sphere(codes: jax.Array, project: Project) -> jax.Array:
    """Projects codes [..., code]."""
    return jax.vmap(project)(codes.reshape(-1, codes.shape[-1])).reshape(codes.shape)


def in_time(schedules: jax.Array, steps: int) -> jax.Array:
    """Returns the code of every step, [steps, rows, code], of schedules [rows, pieces, code]."""
    piece = np.searchsorted(np.asarray(BEGINS) * steps, np.arange(steps), side="right") - 1
    return jnp.swapaxes(schedules[:, piece], 0, 1)


def play_schedules(program: Program, policy: Params, schedules: jax.Array, key: jax.Array, episodes: int) -> jax.Array:
    """Plays schedules [tasks, n, pieces, code] without exploration, all of a task from the same random starts.

    Returns:
      The mean returns [tasks, n] over `episodes` starts.
    """
    family, steps, (tasks, count) = program.family, program.family.episode_length, schedules.shape[:2]
    task = jnp.repeat(jnp.arange(tasks), count)
    rows = jax.tree.map(lambda leaf: leaf[task], program.tasks.params)
    begun = jax.tree.map(lambda leaf: leaf[task], starts(family, program.tasks.params, key, episodes))
    codes = in_time(schedules.reshape(-1, *schedules.shape[2:]), steps)
    codes = jnp.broadcast_to(codes[:, :, None], (*codes.shape[:2], episodes, codes.shape[-1]))

    def record(step: Transition) -> tuple[dict[str, jax.Array], jax.Array]:
        return step.outcome, step.terminated | ~step.valid

    act = act_along(program.agent, policy)
    _, (outcome, over) = rollout(BatchedEnv(family, resets=False), act, begun, codes, record)
    returns = jnp.sum(score(family, outcome, rows, axis=1) * first_episode(over), axis=0)
    return returns.mean(axis=-1).reshape(tasks, count)


def search_epoch(
    program: Program, search: ScheduleSearch, policy: Params, state: Schedules, key: jax.Array
) -> tuple[Schedules, jax.Array]:
    """Makes one epoch of the search; returns its state and the return [tasks] of the schedule that it began with."""
    key_ask, key_play = jax.random.split(key)
    candidates = ask(state, key_ask, search.candidates, program.agent.project)
    returns = play_schedules(program, policy, candidates, key_play, search.starts)
    return tell(state, candidates, returns, search.elites, program.agent.project), returns[:, 0]


def choose(program: Program, policy: Params, schedules: jax.Array, key: jax.Array, episodes: int) -> jax.Array:
    """Returns the schedules [tasks, pieces, code], but a task's own code where they return less than it."""
    own = init(program.agent.codes(policy), 0.0).codes
    both = jnp.stack([own, schedules], axis=1)
    better = jnp.argmax(play_schedules(program, policy, both, key, episodes), axis=1)
    return jnp.where(better[:, None, None] == 1, schedules, own)
