"""LTEs that change with time, so that the robot follows a course: a spline on the sphere, found by a search."""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ear_jax.agents import Agent
from ear_jax.agents.networks import Params
from ear_jax.embeddings.codes import spread_codes
from ear_jax.embeddings.course import Course
from ear_jax.embeddings.smooth import smooth_best
from ear_jax.embeddings.survey import Survey
from ear_jax.envs.batched_env import BatchedEnv, EnvState, Transition
from ear_jax.learning.rollout import act_along, first_episode, rollout
from ear_jax.runs.rollouts import check_rollouts
from ear_jax.runs.trained import Trained, for_each_seed
from ear_jax.runs.training import Program

CHOICES = 4000  # codes that a look-up chooses from
NEAR = 0.02  # of the range of what is followed: a look-up gives up so much for an LTE one radian nearer to the last
ELITES = 8  # plans that the next epoch is drawn around
LEAST = 0.01  # standard deviation of a plan's coordinates below which it does not fall


Searched = tuple[jax.Array, jax.Array, jax.Array, jax.Array]  # mean and deviation of knots, best knots, their cost


@dataclass(frozen=True)
class Plan:
    """Settings of the search for a spline."""

    every: float = 0.5  # seconds between knots
    epochs: int = 10
    candidates: int = 32
    sigma: float = 0.2  # standard deviation of a knot's coordinates in the first epoch
    starts: int = 1  # random starts that each plan is played from


def spline(agent: Agent, knots: jax.Array, steps: int) -> jax.Array:
    """Returns the codes [steps, code] of a spline through knots [knots, code], evenly spaced in time.

    Between two knots they are the normalised sums of both.
    """
    moments = jnp.linspace(0, len(knots) - 1, steps)
    row = jnp.minimum(moments.astype(int), len(knots) - 2)
    share = (moments - row)[:, None]
    return jax.vmap(agent.project)((1 - share) * knots[row] + share * knots[row + 1])


def look_up(survey: Survey, index: int, course: Course, steps: int) -> np.ndarray:
    """Returns the code [steps, code] for each wanted value, from the survey of one seed's policy alone.

    A turn away from the code before counts a little as a miss too.
    """
    later = slice(survey.steps // 2, None)
    late = np.stack([survey.outcomes[name][index, :, later].mean(axis=-1) for name in course.outcomes], axis=1)
    failed = survey.lengths[index] < survey.steps
    late = np.where(failed[:, None], 0.0, late)  # a robot that has failed stays where it is
    candidates = spread_codes(CHOICES, survey.codes.shape[1])
    values = np.concatenate([late, (late**2).sum(axis=1, keepdims=True)], axis=1)
    expected = smooth_best(survey.codes, values, candidates)
    give = (NEAR * np.ptp(late)) ** 2
    codes: list[np.ndarray] = []
    for wanted in course.wanted:
        miss = expected[:, -1] - 2 * expected[:, :-1] @ wanted + (wanted**2).sum()
        apart = np.arccos(np.clip(candidates @ codes[-1], -1, 1)) if codes else 0.0
        codes.append(candidates[int(np.argmin(miss + give * apart**2))])
    return np.array(codes[:steps])


def follow_course(
    trained: Trained, survey: Survey, course: Course, plan: Plan, episodes: int, seed: int
) -> dict[str, Any]:
    """Finds for every seed's policy a spline that follows a course, beside the plain look-up.

    The search is the cross-entropy method over all knots at once, in one compiled call. It begins at the look-up.

    Args:
      trained: the run.
      survey: a survey of its sphere.
      course: what is to be followed.
      plan: settings of the search.
      episodes: fresh starts from which both are played.
      seed: seeds everything.

    Returns:
      The document that `ear follow --json` prints.

    Raises:
      RunError: the roll-outs do not fit in memory.
    """
    began = time.perf_counter()
    program, steps = trained.program, len(course.wanted)
    check_rollouts(program, program.config.seeds * max(plan.candidates * plan.starts, 2 * episodes), steps)
    looked_up = np.stack([look_up(survey, index, course, steps) for index in range(program.config.seeds)])
    count = max(2, round(steps * program.family.dt / plan.every) + 1)
    begin = looked_up[:, np.linspace(0, steps - 1, count).astype(int)]

    def of_seed(policy: Params, key: jax.Array, begin: jax.Array, looked_up: jax.Array) -> dict[str, Any]:
        key_search, key_fresh = jax.random.split(key)
        knots, costs = search_spline(program, policy, begin, course, plan, key_search)
        codes = jnp.stack([looked_up, spline(program.agent, knots, steps)])
        played = _play(program, policy, codes, _starts(program, key_fresh, episodes), course)
        return {"knots": knots, "codes": codes, "costs": costs, **played}

    found = for_each_seed(trained, of_seed, seed, begin, looked_up)
    searched = program.config.seeds * plan.epochs * plan.candidates * plan.starts * steps
    seconds = round(time.perf_counter() - began, 2)
    return {**_describe(trained, course, found), "env_steps": searched, "seconds": seconds, "episodes": episodes}


def search_spline(
    program: Program, policy: Params, begin: jax.Array, course: Course, plan: Plan, key: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Searches for the knots of the spline of least cost.

    Args:
      program, policy: one seed's trained policy.
      begin: knots to begin at [knots, code].
      course: what is to be followed.
      plan: the settings.
      key: seeds everything.

    Returns:
      The best knots [knots, code], and the least cost of each epoch, mean over its starts.
    """
    steps, project = len(course.wanted), jax.vmap(program.agent.project)
    key_starts, key_epochs = jax.random.split(key)
    starts = _starts(program, key_starts, plan.starts)

    def epoch(state: Searched, key: jax.Array) -> tuple[Searched, jax.Array]:
        mean, deviation, best, least = state
        noise = jax.random.normal(key, (plan.candidates - 1, *mean.shape))
        drawn = jnp.concatenate([mean[None], mean + deviation * noise])
        knots = jax.vmap(project)(drawn)
        codes = jax.vmap(partial(spline, program.agent, steps=steps))(knots)
        costs = _play(program, policy, codes, starts, course)["costs_of_starts"].mean(axis=-1)
        order = jnp.argsort(jnp.where(jnp.isfinite(costs), costs, jnp.inf))[:ELITES]
        elites, lowest = knots[order], costs[order[0]]
        best = jnp.where(lowest < least, elites[0], best)
        state = project(elites.mean(axis=0)), jnp.maximum(elites.std(axis=0), LEAST), best, jnp.minimum(lowest, least)
        return state, lowest

    begun = begin, jnp.full(begin.shape, plan.sigma), begin, jnp.float32(jnp.inf)
    (_, _, best, _), costs = jax.lax.scan(epoch, begun, jax.random.split(key_epochs, plan.epochs))
    return best, costs


def _starts(program: Program, key: jax.Array, count: int) -> EnvState:
    """Draws starts, each leaf [1, count, …]."""
    task = jax.tree.map(lambda leaf: leaf[:1], program.tasks.params)
    return BatchedEnv(program.family).start(key, task, count)


def _play(program: Program, policy: Params, codes: jax.Array, starts: EnvState, course: Course) -> dict[str, jax.Array]:
    """Plays codes [rows, steps, code] from the same starts; returns errors, costs and what was followed, by name."""
    family, rows, count = program.family, len(codes), starts.steps.shape[1]
    begun = jax.tree.map(lambda leaf: jnp.repeat(leaf, rows, axis=0), starts)
    of_steps = jnp.broadcast_to(jnp.swapaxes(codes, 0, 1)[:, :, None], (codes.shape[1], rows, count, codes.shape[2]))

    def record(step: Transition) -> tuple[dict[str, jax.Array], jax.Array]:
        return {name: step.outcome[name] for name in course.outcomes}, step.terminated | ~step.valid

    env, act = BatchedEnv(family, resets=False), act_along(program.agent, policy)
    _, (outcome, over) = rollout(env, act, begun, of_steps, record)
    playing = first_episode(over) & ~over
    over_all = jax.vmap(jax.vmap(partial(course.error, dt=family.dt), in_axes=1), in_axes=1)  # rows, then starts
    errors, costs = over_all(outcome, playing)
    followed = jnp.stack([jnp.where(playing, outcome[name], 0.0) for name in course.outcomes], axis=-1)
    return {"errors": errors, "costs_of_starts": costs, "followed": followed[:, :, 0], "lasted": playing[-1].mean(-1)}


def _describe(trained: Trained, course: Course, found: dict[str, Any]) -> dict[str, Any]:
    """Describes the answers of both ways: errors from fresh starts, smoothness, and the course of the first start."""
    program = trained.program
    dt = program.family.dt

    def way(index: int, row: int) -> dict[str, Any]:
        codes, errors = found["codes"][index, row], found["errors"][index, row]
        followed = found["followed"][index, :, row]
        way = np.cumsum(followed, axis=0) * dt if course.is_path else followed
        turns = np.arccos(np.clip((codes[1:] * codes[:-1]).sum(axis=-1), -1, 1))
        return {
            "error": round(float(errors.mean()), 4),
            "errors": np.round(errors, 4).tolist(),
            "lasted": float(found["lasted"][index, row]),
            "turn": round(float(turns.mean() / dt), 4),
            "followed": np.round(way, 3).tolist(),
            "ltes": np.round(codes, 5).tolist(),
        }

    seeds = [
        {
            "seed": program.config.seed + index,
            "costs": np.round(found["costs"][index], 5).tolist(),
            "knots": found["knots"][index].tolist(),
            "ways": {"look-up": way(index, 0), "spline": way(index, 1)},
        }
        for index in range(program.config.seeds)
    ]
    shown = np.cumsum(course.wanted, axis=0) * dt if course.is_path else course.wanted
    return {
        "outcomes": course.outcomes,
        "unit": course.unit,
        "is_path": course.is_path,
        "dt": round(dt, 6),
        "points": np.column_stack([course.times, course.points]).round(4).tolist(),
        "wanted": np.round(shown, 3).tolist(),
        "seeds": seeds,
    }
