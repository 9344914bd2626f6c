"""Schedules: an episode in pieces, each under an LTE and a push of its own, searched by the cross-entropy method.

An episode often returns more if it begins under other LTEs than its task's: what one task has learnt, another can use.
A push is a constant added to the mean of the actions before tanh. A piece is a vector, its LTE and then its push.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from ear_jax.agents import Agent
from ear_jax.agents.networks import Params
from ear_jax.agents.tanh_gaussian import Gaussian
from ear_jax.envs.batched_env import BatchedEnv, Transition
from ear_jax.learning.episodes import starts
from ear_jax.learning.rollout import first_episode, rollout, score
from ear_jax.runs.training import Program

BEGINS = (0.0, 0.025, 0.05, 0.075, 0.1, 0.15, 0.2, 0.3, 0.4, 0.6)  # shares of an episode at which its pieces begin
SLOWNESS = 0.3  # share of a standard deviation that the next epoch keeps


@dataclass(frozen=True)
class ScheduleSearch:
    """Settings of the search."""

    epochs: int = 12
    candidates: int = 48  # schedules a task and epoch
    starts: int = 2  # random starts that each is played from
    elites: int = 8
    sigma: float = 0.3  # standard deviation of an LTE's coordinates in the first epoch
    push: float = 0.3  # that of pushes; 0: none

    def episodes(self, tasks: int) -> int:
        """Returns the episodes of a whole search."""
        return self.epochs * self.candidates * self.starts * tasks


@struct.dataclass
class Schedules:
    """The state of a search: the schedules around which the next candidates are drawn."""

    pieces: jax.Array  # [tasks, pieces, code + act]
    sigma: jax.Array  # as `pieces`, standard deviations


def constant(codes: jax.Array, actions: int) -> jax.Array:
    """Returns schedules [tasks, pieces, code + act] that stay at each task's code, given the table [tasks, code]."""
    pieces = jnp.concatenate([codes, jnp.zeros((len(codes), actions))], axis=1)
    return jnp.repeat(pieces[:, None], len(BEGINS), axis=1)


def init(codes: jax.Array, actions: int, search: ScheduleSearch) -> Schedules:
    """Returns the state of a search that begins at each task's code, given the table [tasks, code]."""
    pieces = constant(codes, actions)
    sigma = jnp.where(jnp.arange(pieces.shape[-1]) < codes.shape[1], search.sigma, search.push)
    return Schedules(pieces, jnp.broadcast_to(sigma, pieces.shape).at[:, -1, codes.shape[1] :].set(0.0))


def ask(state: Schedules, key: jax.Array, count: int, agent: Agent) -> jax.Array:
    """Returns candidates [tasks, count, pieces, code + act], of which each task's first is the mean."""
    tasks, *shape = state.pieces.shape
    noise = jax.random.normal(key, (tasks, count, *shape)).at[:, 0].set(0.0)
    return on_sphere(state.pieces[:, None] + state.sigma[:, None] * noise, agent)


def tell(state: Schedules, candidates: jax.Array, returns: jax.Array, elites: int, agent: Agent) -> Schedules:
    """Moves each task's schedule to the mean of the best candidates, given their returns [tasks, count]."""
    _, best = jax.lax.top_k(returns, elites)
    chosen = jax.vmap(lambda rows, index: rows[index])(candidates, best)
    sigma = (1 - SLOWNESS) * chosen.std(axis=1) + SLOWNESS * state.sigma
    return Schedules(on_sphere(chosen.mean(axis=1), agent), sigma)


def on_sphere(pieces: jax.Array, agent: Agent) -> jax.Array:
    """Projects the codes of pieces [..., code + act]."""
    codes, pushes = jnp.split(pieces, [agent.code_size], axis=-1)
    projected = jax.vmap(agent.project)(codes.reshape(-1, agent.code_size)).reshape(codes.shape)
    return jnp.concatenate([projected, pushes], axis=-1)


def pushed(agent: Agent, policy: Params, piece: jax.Array, obs: jax.Array) -> Gaussian:
    """Returns the distribution of actions under a piece [code + act]."""
    code, push = jnp.split(piece, [agent.code_size])
    plain = agent.distribution(policy, code, obs)
    return Gaussian(plain.mean + push, plain.log_std)


def in_time(schedules: jax.Array, steps: int) -> jax.Array:
    """Returns the piece of every step, [steps, rows, code + act], of schedules [rows, pieces, code + act]."""
    piece = np.searchsorted(np.asarray(BEGINS) * steps, np.arange(steps), side="right") - 1
    return jnp.swapaxes(schedules[:, piece], 0, 1)


def play_schedules(program: Program, policy: Params, schedules: jax.Array, key: jax.Array, episodes: int) -> jax.Array:
    """Plays schedules [tasks, n, pieces, code + act] without exploration, all of a task from the same random starts.

    Returns:
      The mean returns [tasks, n] over `episodes` starts.
    """
    family, steps, (tasks, count) = program.family, program.family.episode_length, schedules.shape[:2]
    task = jnp.repeat(jnp.arange(tasks), count)
    rows = jax.tree.map(lambda leaf: leaf[task], program.tasks.params)
    begun = jax.tree.map(lambda leaf: leaf[task], starts(family, program.tasks.params, key, episodes))
    pieces = in_time(schedules.reshape(-1, *schedules.shape[2:]), steps)
    pieces = jnp.broadcast_to(pieces[:, :, None], (*pieces.shape[:2], episodes, pieces.shape[-1]))

    def act(obs: jax.Array, piece: jax.Array) -> jax.Array:
        return jnp.tanh(pushed(program.agent, policy, piece, obs).mean)

    def record(step: Transition) -> tuple[dict[str, jax.Array], jax.Array]:
        return step.outcome, step.terminated | ~step.valid

    act_all = jax.vmap(jax.vmap(act))
    _, (outcome, over) = rollout(BatchedEnv(family, resets=False), act_all, begun, pieces, record)
    returns = jnp.sum(score(family, outcome, rows, axis=1) * first_episode(over), axis=0)
    return returns.mean(axis=-1).reshape(tasks, count)


def search_epoch(
    program: Program, search: ScheduleSearch, policy: Params, state: Schedules, key: jax.Array
) -> tuple[Schedules, jax.Array]:
    """Makes one epoch of the search; returns its state and the return [tasks] of the schedule that it began with."""
    key_ask, key_play = jax.random.split(key)
    candidates = ask(state, key_ask, search.candidates, program.agent)
    returns = play_schedules(program, policy, candidates, key_play, search.starts)
    return tell(state, candidates, returns, search.elites, program.agent), returns[:, 0]


def choose(program: Program, policy: Params, schedules: jax.Array, key: jax.Array, episodes: int) -> jax.Array:
    """Returns the schedules [tasks, pieces, code + act], but a task's own code where they return less than it."""
    own = constant(program.agent.codes(policy), program.family.action_size)
    both = jnp.stack([own, schedules], axis=1)
    better = jnp.argmax(play_schedules(program, policy, both, key, episodes), axis=1)
    return jnp.where(better[:, None, None] == 1, schedules, own)
