"""Adaptation to tasks never trained on: only the code is searched, the networks stay as they are."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from ear_jax import atlas, cem
from ear_jax.belief import Context
from ear_jax.evaluate import play
from ear_jax.grid import Grid, Transition
from ear_jax.networks import Params
from ear_jax.rollout import act_with, rollout
from ear_jax.runtime import compiler_options
from ear_jax.tasks import Task, TaskParams, TaskSet
from ear_jax.train import Program, evaluation_keys
from ear_jax.trained import Trained


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
        again, achieved = _judge(program, policy, best, tasks, key_again, episodes)
        return state, Progress(returns.max(axis=1), again, achieved, best)

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
        codes = infer(policy, known).draw(jax.random.normal(key_code, (count, agent.code_size)))
        noise = jax.random.normal(key_noise, (steps, count, 1, family.action_size))
        act = act_with(agent, policy, codes)
        _, played = rollout(Grid(family), act, Grid(family).start(key_start, tasks, 1), noise, record)
        obs, action, outcome, over = jax.tree.map(lambda leaf: jnp.swapaxes(leaf, 0, 1), played)  # [tasks, steps, …]
        playing = jnp.cumsum(over, axis=1) - over == 0
        reward = score(outcome, tasks)
        new = Context(obs, action, scale * reward, playing)
        known = jax.tree.map(lambda all, one: jax.lax.dynamic_update_slice_in_dim(all, one, index, 1), known, new)
        mean = infer(policy, known).mean
        again, achieved = _judge(program, policy, mean, tasks, key_again, episodes)
        return known, Progress(jnp.sum(jnp.where(playing, reward, 0.0), axis=1), again, achieved, mean)

    size = (count, trials * steps)
    obs, action = jnp.zeros((*size, family.observation_size)), jnp.zeros((*size, family.action_size))
    nothing = Context(obs, action, jnp.zeros(size), jnp.zeros(size, bool))
    return jax.lax.scan(trial, nothing, (steps * jnp.arange(trials), jax.random.split(key, trials)))[1]


def adapt(
    trained: Trained, tasks: TaskSet, search: Search | None, episodes: int, seed: int, places: int = atlas.PLACES
) -> dict[str, Any]:
    """Adapts every seed's policy to every task, by search and from a map of the sphere.

    Args:
      trained: the run.
      tasks: the tasks.
      search: how to search; None: only the map.
      episodes: fresh episodes by which a code is judged.
      seed: seeds everything.
      places: codes of the map; it answers tasks that command something within reach, where the agent has LTEs on a
        sphere.

    Returns:
      What `ear adapt --json` prints.

    Raises:
      UsageError: only the map, and a target that no surveyed code comes near or an agent without LTEs.
    """
    began = time.perf_counter()
    program, config = trained.program, trained.program.config
    on_sphere = program.agent.embed is not None and config.network.normalise_lte
    mapped = search is None or on_sphere
    commanding = [(task, task.target) for task in tasks.tasks if task.target is not None and mapped]
    atlases = atlas.survey(trained, places, 1, seed) if commanding else []
    if search is None:
        for _, target in commanding:
            atlas.check_reach(atlases, program.family, target)
    answers = zero_shot(trained, atlases, commanding, episodes, seed) if commanding else {}
    searched = _search_all(trained, tasks, search, seed, episodes) if search else {}
    found = [
        {
            "seed": run_seed,
            "name": task.name,
            "target": task.target,
            "lte": (searched or answers)[run_seed, task.name]["lte"],
            "epochs": searched[run_seed, task.name]["epochs"] if search else [],
            "zero_shot": answers.get((run_seed, task.name)),
        }
        for run_seed in range(config.seed, config.seed + config.seeds)
        for task in tasks.tasks
    ]
    candidates = 1 if program.agent.infer else search.candidates if search else 0
    episodes_searched = len(tasks) * search.epochs * candidates if search else 0
    seeds_steps = config.seeds * program.family.episode_length
    return {
        "tasks": found,
        "env_steps": seeds_steps * episodes_searched,
        "map_env_steps": seeds_steps * (places if atlases else 0),
        "seconds": round(time.perf_counter() - began, 2),
    }


def _search_all(
    trained: Trained, tasks: TaskSet, search: Search, seed: int, episodes: int
) -> dict[tuple[int, str], dict[str, Any]]:
    """Every seed's search for every task in one call, by seed and task."""
    program, count = trained.program, trained.program.config.seeds
    keys = jax.random.split(jax.random.key(seed), count)

    def of_seed(policy: Params, key: jax.Array) -> Progress:
        if program.agent.infer:
            return infer_codes(program, policy, tasks.params, key, search.epochs, episodes)
        return search_codes(program, policy, tasks.params, key, search, episodes)

    progress = jax.device_get(jax.jit(jax.vmap(of_seed), compiler_options=compiler_options())(trained.policies, keys))

    def describe(index: int, row: int) -> dict[str, Any]:
        curves = {name: getattr(progress, name)[index, :, row] for name in ("best_of_epoch", "reevaluated", "achieved")}
        epochs = [{name: float(curve[epoch]) for name, curve in curves.items()} for epoch in range(search.epochs)]
        return {"lte": progress.code[index, -1, row].tolist(), "epochs": epochs}

    return {
        (program.config.seed + index, task.name): describe(index, row)
        for index in range(count)
        for row, task in enumerate(tasks.tasks)
    }


def zero_shot(
    trained: Trained, atlases: Sequence[atlas.Atlas], commanding: Sequence[tuple[Task, float]], episodes: int, seed: int
) -> dict[tuple[int, str], dict[str, Any]]:
    """For every seed, and every task that its map reaches, the code that the map promises and what it then achieves.

    Args:
      trained: the run.
      atlases: the map of each seed.
      commanding: the tasks, each with what it commands.
      episodes: fresh episodes by which a code is judged.
      seed: of their starts.
    """
    program, family = trained.program, trained.program.family
    chosen = [[atlas.place_for(one, family, target) for _, target in commanding] for one in atlases]
    codes = jnp.array([[code for code, _ in row] for row in chosen])
    params = TaskSet(tuple(task for task, _ in commanding)).params
    keys = evaluation_keys(jax.random.split(jax.random.key(seed), len(atlases)), 0)

    def of_seed(policy: Params, codes: jax.Array, key: jax.Array) -> tuple[jax.Array, jax.Array]:
        return _judge(program, policy, codes, params, key, episodes)

    judge_all = jax.jit(jax.vmap(of_seed), compiler_options=compiler_options())
    returns, achieved = jax.device_get(judge_all(trained.policies, codes, keys))
    return {
        (program.config.seed + index, task.name): {
            "lte": codes[index, row].tolist(),
            "predicted": chosen[index][row][1],
            "achieved": float(achieved[index, row]),
            "error": abs(float(family.difference(achieved[index, row], target))),
            "reevaluated": float(returns[index, row]),
        }
        for index, one in enumerate(atlases)
        for row, (task, target) in enumerate(commanding)
        if atlas.reaches(one, family, target)
    }


def _judge(
    program: Program, policy: Params, codes: jax.Array, tasks: TaskParams, key: jax.Array, episodes: int
) -> tuple[jax.Array, jax.Array]:
    """Mean return and commanded quantity of codes [rows, code] on fresh episodes of their tasks, each [rows]."""
    played = play(program.family, program.agent, policy, codes, tasks, key, episodes)
    late, whole = (jax.tree.map(lambda leaf: leaf.mean(axis=-1), means) for means in (played.late, played.whole))
    return played.returns.mean(axis=-1), program.family.achieved(late, whole)
