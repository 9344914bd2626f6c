"""Ways to a code for a task never trained on: the cross-entropy method, inference, gradient steps."""

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
from ear_jax.learning.rollout import act_with, rollout
from ear_jax.runs.training import Program
from ear_jax.tasks import TaskParams


@dataclass(frozen=True)
class Search:
    """How the cross-entropy method searches; the defaults are the authors' code's."""

    epochs: int = 10
    elites: int = 6
    samples: int = 14
    sigma: float = 0.5

    @property
    def candidates(self) -> int:
        """Episodes a task and epoch."""
        return self.elites * (1 + self.samples)


@struct.dataclass
class Progress:
    """One seed's search, each leaf [epochs, tasks, …]."""

    best_of_epoch: jax.Array  # the best of the candidates' returns, one noisy episode each: the paper's curve
    reevaluated: jax.Array  # the return of that candidate on fresh episodes, without exploration
    achieved: jax.Array  # the commanded quantity in them
    code: jax.Array  # that candidate


def reevaluate(
    program: Program, policy: Params, codes: jax.Array, tasks: TaskParams, key: jax.Array, episodes: int
) -> tuple[jax.Array, jax.Array]:
    """Mean return and commanded quantity of codes [rows, code] on fresh episodes of their tasks, each [rows]."""
    played = play(program.family, program.agent, policy, codes, tasks, key, episodes)
    return played.returns.mean(axis=-1), achieved(program.family, played)


def find_codes(
    program: Program, policy: Params, tasks: TaskParams, key: jax.Array, search: Search, episodes: int
) -> Progress:
    """Finds a code for each task in the agent's own way; arguments as of `search_codes`."""
    if program.agent.tuned:
        return tune_codes(program, policy, tasks, key, search.epochs, episodes)
    if program.agent.infer:
        return infer_codes(program, policy, tasks, key, search.epochs, episodes)
    return search_codes(program, policy, tasks, key, search, episodes)


def episodes_an_epoch(program: Program, search: Search) -> int:
    """What one epoch plays a task: all candidates, or as much as a code is found from."""
    if program.agent.tuned:
        return program.config.collect.envs
    return 1 if program.agent.infer else search.candidates


def search_codes(
    program: Program, policy: Params, tasks: TaskParams, key: jax.Array, search: Search, episodes: int
) -> Progress:
    """Searches a code for each task, all tasks and candidates in one roll-out an epoch.

    Args:
      program, policy: one seed's trained policy.
      tasks: each leaf [tasks].
      key: seeds everything.
      search: how.
      episodes: fresh episodes by which an epoch's best is judged again.
    """
    family, agent = program.family, program.agent
    count = len(jax.tree.leaves(tasks)[0])
    key_init, key_epochs = jax.random.split(key)
    begin = partial(cem.init, elites=search.elites, code_size=agent.code_size, project=agent.project)
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

    state = jax.vmap(begin)(jax.random.split(key_init, count))
    return jax.lax.scan(epoch, state, jax.random.split(key_epochs, search.epochs))[1]


def infer_codes(
    program: Program, policy: Params, tasks: TaskParams, key: jax.Array, trials: int, episodes: int
) -> Progress:
    """Infers a code for each task from episodes of it, as PEARL does: each is played under a code drawn from what those
    before it tell, the first under one from the prior.

    Args:
      program, policy: one seed's trained policy, of an agent that infers codes.
      tasks: each leaf [tasks].
      key: seeds everything.
      trials: how many episodes.
      episodes: fresh episodes by which the mean of the belief after each is judged.

    Returns:
      What came of each trial, in place of an epoch; the best of its one candidate is that.
    """
    family, agent = program.family, program.agent
    assert agent.infer
    infer, scale = jax.vmap(agent.infer, in_axes=(None, 0)), program.config.sac.reward_scale
    count, steps = len(jax.tree.leaves(tasks)[0]), family.episode_length
    score = jax.vmap(jax.vmap(family.reward, in_axes=(0, None)))

    def record(step: Transition) -> tuple[jax.Array, ...]:
        seen = (step.obs, step.action, step.outcome, step.terminated | ~step.valid)
        return jax.tree.map(lambda leaf: leaf[:, 0], seen)  # [tasks, …]

    def trial(known: Context, given: tuple[jax.Array, jax.Array]) -> tuple[Context, Progress]:
        index, key = given
        key_code, key_start, key_noise, key_again = jax.random.split(key, 4)
        codes = infer(policy, known).sample(jax.random.normal(key_code, (count, agent.code_size)))
        noise = jax.random.normal(key_noise, (steps, count, 1, family.action_size))
        act = act_with(agent, policy, codes)
        _, played = rollout(BatchedEnv(family), act, BatchedEnv(family).start(key_start, tasks, 1), noise, record)
        obs, action, outcome, over = jax.tree.map(lambda leaf: jnp.swapaxes(leaf, 0, 1), played)  # [tasks, steps, …]
        playing = jnp.cumsum(over, axis=1) - over == 0
        reward = score(outcome, tasks)
        new = Context(obs, action, scale * reward, playing)
        known = jax.tree.map(lambda all, one: jax.lax.dynamic_update_slice_in_dim(all, one, index, 1), known, new)
        mean = infer(policy, known).mean
        again, reached = reevaluate(program, policy, mean, tasks, key_again, episodes)
        return known, Progress(jnp.sum(jnp.where(playing, reward, 0.0), axis=1), again, reached, mean)

    size = (count, trials * steps)
    obs, action = jnp.zeros((*size, family.observation_size)), jnp.zeros((*size, family.action_size))
    nothing = Context(obs, action, jnp.zeros(size), jnp.zeros(size, bool))
    return jax.lax.scan(trial, nothing, (steps * jnp.arange(trials), jax.random.split(key, trials)))[1]


def tune_codes(
    program: Program, policy: Params, tasks: TaskParams, key: jax.Array, steps: int, episodes: int
) -> Progress:
    """Tunes a code to each task by gradient steps on episodes of it, as MAML does.

    Args:
      program, policy: one seed's trained policy, of an agent whose codes are tuned.
      tasks: each leaf [tasks].
      key: seeds everything.
      steps: how many, each on episodes under what the one before led to.
      episodes: fresh episodes by which the code after each is judged.

    Returns:
      What came of each step, in place of an epoch; the best of its one candidate is the mean of the episodes before it.
    """
    learner = program.learner
    assert isinstance(learner, MamlLearner)

    def step(codes: jax.Array, key: jax.Array) -> tuple[jax.Array, Progress]:
        key_play, key_again = jax.random.split(key)
        trials, returns, _ = learner.play(policy, codes, tasks, key_play)
        codes = learner.tune(policy, codes, trials)
        again, reached = reevaluate(program, policy, codes, tasks, key_again, episodes)
        return codes, Progress(returns.mean(axis=1), again, reached, codes)

    origin = jnp.zeros((len(jax.tree.leaves(tasks)[0]), program.agent.code_size))
    return jax.lax.scan(step, origin, jax.random.split(key, steps))[1]
