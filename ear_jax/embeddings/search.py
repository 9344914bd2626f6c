"""Codes for tasks never trained on, by the cross-entropy method, by inference (PEARL) or by gradient steps (MAML)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
from flax import struct

from ear_jax.agents.networks import Params
from ear_jax.agents.posterior import Context
from ear_jax.embeddings import cem
from ear_jax.envs.batched_env import BatchedEnv, Transition
from ear_jax.learning.episodes import achieved, play
from ear_jax.learning.maml import MamlLearner
from ear_jax.learning.rollout import act_with, first_episode, rollout, score
from ear_jax.runs.training import Program
from ear_jax.tasks import TaskParams, task_count


@dataclass(frozen=True)
class Search:
    """Settings of the cross-entropy method; the defaults are those of the authors' code."""

    epochs: int = 10
    elites: int = 6  # best candidates of an epoch, which the next begins from
    samples: int = 14  # candidates drawn around each of them
    sigma: float = 0.5  # standard deviation of each coordinate of a draw

    @property
    def candidates(self) -> int:
        """Candidates per task and epoch, each played for one episode."""
        return self.elites * (1 + self.samples)


@struct.dataclass
class Progress:
    """The course of one seed's search, each leaf [epochs, tasks, …]."""

    best_of_epoch: jax.Array  # best return among the candidates, from one noisy episode each: the paper's curve
    reevaluated: jax.Array  # mean return of that candidate in fresh episodes, without exploration
    achieved: jax.Array  # commanded quantity in those episodes
    code: jax.Array  # that candidate


def reevaluate(
    program: Program, policy: Params, codes: jax.Array, tasks: TaskParams, key: jax.Array, episodes: int
) -> tuple[jax.Array, jax.Array]:
    """Returns the mean return and the commanded quantity, each [rows], of codes [rows, code] in fresh episodes."""
    played = play(program.family, program.agent, policy, codes, tasks, key, episodes)
    return played.returns.mean(axis=-1), achieved(program.family, played)


def find_codes(
    program: Program, policy: Params, tasks: TaskParams, key: jax.Array, search: Search, episodes: int
) -> Progress:
    """Finds a code for each task by the agent's own means; arguments as in `search_codes`."""
    if program.agent.tuned:
        return tune_codes(program, policy, tasks, key, search.epochs, episodes)
    if program.agent.infer:
        return infer_codes(program, policy, tasks, key, search.epochs, episodes)
    return search_codes(program, policy, tasks, key, search, episodes)


def episodes_an_epoch(program: Program, search: Search) -> int:
    """Returns the episodes that one epoch of `find_codes` plays per task, re-evaluations aside."""
    if program.agent.tuned:
        return program.config.collect.envs
    return 1 if program.agent.infer else search.candidates


def env_steps_an_epoch(program: Program, search: Search) -> int:
    """Returns the env steps that those episodes may take."""
    steps = program.config.collect.steps // 2 if program.agent.tuned else program.family.episode_length
    return steps * episodes_an_epoch(program, search)


def search_codes(
    program: Program, policy: Params, tasks: TaskParams, key: jax.Array, search: Search, episodes: int
) -> Progress:
    """Searches by the cross-entropy method for a code for each task, with one roll-out per epoch for all candidates.

    Args:
      program, policy: one seed's trained policy.
      tasks: each leaf [tasks].
      key: seeds everything.
      search: the settings.
      episodes: fresh episodes in which the best candidate of each epoch is evaluated again.
    """
    family, agent = program.family, program.agent
    count = task_count(tasks)
    key_init, key_epochs = jax.random.split(key)
    init = partial(cem.init, elites=search.elites, code_size=agent.code_size, project=agent.project)
    ask = partial(cem.ask, samples=search.samples, sigma=search.sigma, project=agent.project)
    per_candidate = jax.tree.map(lambda leaf: jnp.repeat(leaf, search.candidates), tasks)

    def epoch(state: cem.Cem, key: jax.Array) -> tuple[cem.Cem, Progress]:
        key_ask, key_play, key_again = jax.random.split(key, 3)
        candidates = jax.vmap(ask)(state, jax.random.split(key_ask, count))
        rows = candidates.reshape(-1, agent.code_size)
        played = play(family, agent, policy, rows, per_candidate, key_play, 1, explore=True)
        returns = played.returns.reshape(count, search.candidates)
        state = jax.vmap(cem.tell)(state, candidates, returns)
        best = state.elites[:, 0]
        again, reached = reevaluate(program, policy, best, tasks, key_again, episodes)
        return state, Progress(returns.max(axis=1), again, reached, best)

    state = jax.vmap(init)(jax.random.split(key_init, count))
    return jax.lax.scan(epoch, state, jax.random.split(key_epochs, search.epochs))[1]


def infer_codes(
    program: Program, policy: Params, tasks: TaskParams, key: jax.Array, trials: int, episodes: int
) -> Progress:
    """Infers a code for each task from episodes of it, as PEARL does.

    The first episode is played under a code drawn from the prior, each later one under a code drawn from the posterior
    given the episodes before it.

    Args:
      program, policy: one seed's trained policy, of an agent that infers codes.
      tasks: each leaf [tasks].
      key: seeds everything.
      trials: number of episodes.
      episodes: fresh episodes in which the posterior mean after each trial is evaluated.

    Returns:
      One entry per trial in place of an epoch. The trial is its only candidate, and `code` the posterior mean after it.
    """
    family, agent = program.family, program.agent
    assert agent.infer
    infer, scale = jax.vmap(agent.infer, in_axes=(None, 0)), program.config.sac.reward_scale
    count, steps = task_count(tasks), family.episode_length
    env = BatchedEnv(family, resets=False)

    def record(step: Transition) -> tuple[jax.Array, ...]:
        kept = (step.obs, step.action, step.outcome, step.failed, step.valid)
        return jax.tree.map(lambda leaf: leaf[:, 0], kept)  # [tasks, …]

    def trial(context: Context, index_and_key: tuple[jax.Array, jax.Array]) -> tuple[Context, Progress]:
        index, key = index_and_key
        key_code, key_start, key_noise, key_again = jax.random.split(key, 4)
        codes = infer(policy, context).sample(jax.random.normal(key_code, (count, agent.code_size)))
        noise = jax.random.normal(key_noise, (steps, count, 1, family.action_size))
        act = act_with(agent, policy, codes)
        _, played = rollout(env, act, env.start(key_start, tasks, 1), noise, record)
        played = jax.tree.map(lambda leaf: jnp.swapaxes(leaf, 0, 1), played)  # [tasks, steps, …]
        obs, action, outcome, over, valid = played
        playing = first_episode(over, axis=1) & valid
        reward = jnp.where(playing, score(family, outcome, tasks), 0.0)
        new = Context(obs, action, scale * reward, playing)
        context = jax.tree.map(lambda all, part: jax.lax.dynamic_update_slice_in_dim(all, part, index, 1), context, new)
        mean = infer(policy, context).mean
        again, reached = reevaluate(program, policy, mean, tasks, key_again, episodes)
        return context, Progress(jnp.sum(reward, axis=1), again, reached, mean)

    size = (count, trials * steps)
    obs, action = jnp.zeros((*size, family.observation_size)), jnp.zeros((*size, family.action_size))
    empty = Context(obs, action, jnp.zeros(size), jnp.zeros(size, bool))
    return jax.lax.scan(trial, empty, (steps * jnp.arange(trials), jax.random.split(key, trials)))[1]


def tune_codes(
    program: Program, policy: Params, tasks: TaskParams, key: jax.Array, steps: int, episodes: int
) -> Progress:
    """Tunes a code to each task by gradient steps on episodes of it, as MAML does.

    Args:
      program, policy: one seed's trained policy, of an agent whose codes are tuned.
      tasks: each leaf [tasks].
      key: seeds everything.
      steps: number of gradient steps, each on episodes under the code of the step before.
      episodes: fresh episodes in which the code after each step is evaluated.

    Returns:
      One entry per step in place of an epoch. `best_of_epoch` is the mean return of the episodes that the step learns
      from, and `code` the code after it.
    """
    learner = program.learner
    assert isinstance(learner, MamlLearner)

    def step(codes: jax.Array, key: jax.Array) -> tuple[jax.Array, Progress]:
        key_play, key_again = jax.random.split(key)
        trials, returns, _ = learner.play(policy, codes, tasks, key_play)
        codes = learner.tune(policy, codes, trials)
        again, reached = reevaluate(program, policy, codes, tasks, key_again, episodes)
        return codes, Progress(returns.mean(axis=1), again, reached, codes)

    origin = jnp.zeros((task_count(tasks), program.agent.code_size))
    return jax.lax.scan(step, origin, jax.random.split(key, steps))[1]
