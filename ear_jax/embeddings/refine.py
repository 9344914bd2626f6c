"""Refinement: a policy is taught to do under each task's LTE what a schedule of LTEs and small pushes does better.

The policy of a task is often no best response among what the policy can do: critics do not resolve what a few steps
under another LTE are worth, but whole episodes do. A search over schedules finds better episodes, and the networks are
taught to play them. LTEs stay where they are, and the policy a function of the observation and the LTE.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ear_jax.agents.networks import Params
from ear_jax.embeddings import schedule
from ear_jax.embeddings.map import check_sphere
from ear_jax.embeddings.schedule import BEGINS, ScheduleSearch, choose, play_schedules, search_epoch
from ear_jax.embeddings.teach import Teaching, enrol, teach
from ear_jax.process.runtime import compiler_options
from ear_jax.process.terminal import phase, say
from ear_jax.runs.rollouts import check_rollouts
from ear_jax.runs.trained import Trained
from ear_jax.runs.training import Program


@dataclass(frozen=True)
class Refinement:
    """Settings of a refinement."""

    rounds: int = 2  # each searches schedules of the policy of the round before
    search: ScheduleSearch = field(default_factory=ScheduleSearch)
    teaching: Teaching = field(default_factory=Teaching)


def refine(trained: Trained, settings: Refinement, episodes: int = 20, seed: int = 0) -> tuple[Trained, dict[str, Any]]:
    """Refines every seed's policy.

    Args:
      trained: the run.
      settings: of the search and of teaching.
      episodes: fresh episodes a task in which policies and schedules are compared.
      seed: seeds everything.

    Returns:
      The refined policies, whose `about` tells of it, and the document that `ear refine --json` prints.

    Raises:
      UsageError: the agent has no LTEs, or they do not lie on a sphere.
      RunError: the episodes do not fit in memory.
    """
    check_sphere(trained)
    program, count, began = trained.program, trained.program.config.seeds, time.perf_counter()
    tasks, steps = len(program.tasks), program.family.episode_length
    check_rollouts(
        program, count * tasks * max(2 * episodes, settings.search.candidates * settings.search.starts), steps
    )
    keys = jax.random.split(jax.random.fold_in(jax.random.key(seed), 1), (settings.rounds, 3, count))
    fresh = jax.random.split(jax.random.fold_in(jax.random.key(seed), 2), count)
    table = jax.vmap(program.agent.codes)(trained.policies)
    own = jax.vmap(lambda codes: schedule.constant(codes, program.family.action_size))(table)
    play_all = _for_seeds(partial(play_schedules, program, episodes=episodes))
    pick = _for_seeds(partial(choose, program, episodes=episodes))
    advance = _for_seeds(partial(search_epoch, program, settings.search))
    learn = _for_seeds(partial(teach, program, settings.teaching))

    def play(policies: Params, schedules: jax.Array) -> np.ndarray:
        with phase(f"playing {episodes} episodes of {tasks} tasks"):
            return np.asarray(play_all(policies, schedules[:, :, None], fresh))[..., 0]

    policies, rounds = trained.policies, []
    before = returns = play(policies, own)
    for number, of_round in enumerate(keys, 1):
        say(f"round {number} of {settings.rounds}: mean return {returns.mean():.1f}")
        schedules, course = _search(program, settings.search, advance, policies, table, of_round[0])
        with phase("choosing among them and the tasks' own LTEs"):
            schedules = jax.block_until_ready(pick(policies, schedules, of_round[2]))
        scheduled = play(policies, schedules)
        say(f"schedules of LTEs: mean return {scheduled.mean():.1f}")
        policies, apart = _teach(program, settings.teaching, learn, policies, schedules, of_round[1])
        returns = play(policies, own)
        rounds.append((np.asarray(schedules), np.asarray(course), scheduled, apart, returns))
    cost = _cost(program, settings, episodes)
    refined = replace(trained, policies=policies, about=_about(trained, cost, before, returns))
    document = {
        "run": trained.name,
        "episodes": episodes,
        "begins": [round(share * steps) for share in BEGINS],
        "env_steps": cost["env_steps"],
        "updates": cost["updates"],
        "seconds": round(time.perf_counter() - began, 2),
        "seeds": [_describe(program, index, before, rounds) for index in range(count)],
    }
    return refined, document


def _cost(program: Program, settings: Refinement, episodes: int) -> dict[str, int]:
    """Returns the rounds, and the env steps and gradient steps of a seed."""
    tasks, rounds, passes = len(program.tasks), settings.rounds, settings.teaching.passes
    played = settings.search.episodes(tasks) + 2 * tasks * episodes + passes * settings.teaching.all_episodes(tasks)
    env_steps = rounds * played * program.family.episode_length
    return {"rounds": rounds, "env_steps": env_steps, "updates": rounds * passes * settings.teaching.updates}


def _about(trained: Trained, cost: dict[str, int], before: np.ndarray, after: np.ndarray) -> dict[str, Any]:
    """Returns what a refined policy's file tells of it; the costs of earlier refinements are included."""
    earlier = trained.about.get("refined", {})
    refined = {
        **{name: value + earlier.get(name, 0) for name, value in cost.items()},
        "from": trained.fingerprint,
        "mean_returns": [[float(one.mean()) for one in pair] for pair in zip(before, after, strict=True)],
    }
    return {**trained.about, "refined": refined}


def _for_seeds(of_seed: Callable[..., Any]) -> Callable[..., Any]:
    """Compiles a function of one seed for all of them."""
    return jax.jit(jax.vmap(of_seed), compiler_options=compiler_options())


def _search(
    program: Program,
    search: ScheduleSearch,
    advance: Callable[..., Any],
    policies: Params,
    table: jax.Array,
    keys: jax.Array,
) -> tuple[jax.Array, list[np.ndarray]]:
    """Searches a schedule for each seed and task, [seeds, tasks, pieces, code + act], and tells each epoch's return."""
    state = jax.vmap(lambda codes: schedule.init(codes, program.family.action_size, search))(table)
    course = []
    for epoch in range(search.epochs):
        with phase(f"searching schedules of LTEs, epoch {epoch + 1} of {search.epochs}"):
            state, returns = advance(policies, state, jax.vmap(jax.random.fold_in, (0, None))(keys, epoch))
            course.append(np.asarray(returns).mean(axis=1))
    return state.pieces, course


def _teach(
    program: Program,
    teaching: Teaching,
    learn: Callable[..., Any],
    teachers: Params,
    schedules: jax.Array,
    keys: jax.Array,
) -> tuple[Params, np.ndarray]:
    """Teaches each seed's policy its schedules; returns the policies, and how far they are from them, [seeds]."""
    students = jax.vmap(partial(enrol, program, teaching))(teachers)
    apart = jnp.zeros(len(keys))
    for number in range(teaching.passes):
        with phase(f"teaching them to the policy, pass {number + 1} of {teaching.passes}"):
            of_pass = jax.vmap(jax.random.fold_in, (0, None))(keys, number)
            students, apart = jax.block_until_ready(learn(teachers, schedules, students, of_pass))
    return students.policy, np.asarray(apart)


def _describe(program: Program, index: int, before: np.ndarray, rounds: Sequence[tuple[Any, ...]]) -> dict[str, Any]:
    """Turns one seed's returns and schedules into its part of the document."""
    return {
        "seed": program.config.seed + index,
        "mean_return": float(before[index].mean()),
        "returns": before[index].tolist(),
        "tasks": program.tasks.names,
        "rounds": [
            {
                "scheduled": float(scheduled[index].mean()),
                "refined": float(refined[index].mean()),
                "returns_scheduled": scheduled[index].tolist(),
                "returns_refined": refined[index].tolist(),
                "search": course[:, index].tolist(),
                "apart": float(apart[index]),
                "schedules": np.round(schedules[index], 5).tolist(),
            }
            for schedules, course, scheduled, apart, refined in rounds
        ],
    }
