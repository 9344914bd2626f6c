"""LTEs that change with time, so that the robot follows a course: along a searched spline, or chosen on the way.

A profile is followed along a spline on the sphere, which the cross-entropy method finds; way-points, by pursuit. Beside
either stands the plain look-up. One compiled roll-out serves the search, the fresh starts and the film.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ear_jax.agents.networks import Params
from ear_jax.embeddings.codes import spread_codes
from ear_jax.embeddings.course import Course
from ear_jax.embeddings.pursuit import HEADINGS, Pursuit
from ear_jax.embeddings.smooth import smooth_best
from ear_jax.embeddings.survey import Survey
from ear_jax.embeddings.trajectory import PoseEnv, Trajectory, outcome_and_over, until_over
from ear_jax.learning.rollout import act_along, first_episode, rollout
from ear_jax.process.runtime import compiler_options
from ear_jax.runs.rollouts import check_rollouts
from ear_jax.runs.trained import Trained
from ear_jax.runs.training import Program
from ear_jax.tasks import any_task

CHOICES = 4000  # codes that a look-up chooses from
NEAR = 0.02  # of the range of what is followed: a look-up gives up so much for an LTE one radian nearer to the last
ELITES = 8  # splines that the next epoch is drawn around
LEAST = 0.01  # standard deviation of a knot's coordinates below which it does not fall
MEASURES = ("errors", "costs", "ends")  # of a course

Play = Callable[[np.ndarray, np.ndarray], dict[str, Any]]


@dataclass(frozen=True)
class SplineSearch:
    """Settings of the search for a spline."""

    every: float = 0.5  # seconds between knots
    epochs: int = 10
    candidates: int = 32
    sigma: float = 0.2  # standard deviation of a knot's coordinates in the first epoch
    starts: int = 1  # random starts that each spline is played from


def spline(knots: np.ndarray, steps: int) -> np.ndarray:
    """Returns the codes [..., steps, code] of splines through knots [..., knots, code], evenly spaced in time.

    Between two knots they are the normalised sums of both.
    """
    moments = np.linspace(0, knots.shape[-2] - 1, steps)
    row = np.minimum(moments.astype(int), knots.shape[-2] - 2)
    share = (moments - row)[:, None]
    return _on_sphere((1 - share) * knots[..., row, :] + share * knots[..., row + 1, :])


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
    trained: Trained, survey: Survey, course: Course, search: SplineSearch, episodes: int, seed: int
) -> tuple[dict[str, Any], dict[str, Trajectory]]:
    """Follows a course with every seed's policy, beside the plain look-up.

    Args:
      trained: the run.
      survey: a survey of its sphere.
      course: what is to be followed.
      search: settings of the search for a profile's spline, which begins at the look-up.
      episodes: fresh starts from which both are played.
      seed: seeds everything.

    Returns:
      The document that `ear follow --json` prints; and what the first seed's robot did from the first of these starts,
      by the name of the way.

    Raises:
      RunError: the roll-outs do not fit in memory.
    """
    began = time.perf_counter()
    program, steps, seeds = trained.program, len(course.wanted), range(trained.program.config.seeds)
    width = max(2 * episodes, 0 if course.is_path else search.candidates * search.starts)
    check_rollouts(program, len(seeds) * width, steps + 1, program.family.model.nq)
    looked_up = np.stack([look_up(survey, index, course, steps) for index in seeds])
    play = _player(trained, survey, course, width, search.starts + episodes, seed)

    if course.is_path:
        names, codes, about = ("look-up", "pursuit"), np.stack([looked_up, looked_up], axis=1), {}
    else:
        count = max(2, round(steps * program.family.dt / search.every) + 1)
        begin = looked_up[:, np.linspace(0, steps - 1, count).astype(int)]
        knots, costs = search_spline(play, begin, steps, search, seed)
        names, codes = ("look-up", "spline"), np.stack([looked_up, spline(knots, steps)], axis=1)
        about = {"knots": knots, "costs": costs}
    played = play(codes, search.starts + np.arange(episodes))
    document = {**_describe(trained, course, names, played, about), "episodes": episodes}
    document["env_steps"] = len(seeds) * search.epochs * search.candidates * search.starts * steps if about else 0
    document["seconds"] = round(time.perf_counter() - began, 2)
    return document, {name: _trajectory(program, played, row) for row, name in enumerate(names)}


def search_spline(
    play: Play, begin: np.ndarray, steps: int, search: SplineSearch, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """Searches by the cross-entropy method for the knots of the spline of least cost, over all knots at once.

    Args:
      play: plays codes from starts, as `_player` makes it.
      begin: knots to begin at [seeds, knots, code].
      steps: of the course.
      search: the settings.
      seed: seeds the candidates.

    Returns:
      The best knots [seeds, knots, code], and the least cost of each epoch [seeds, epochs], mean over its starts.
    """
    rng = np.random.default_rng(seed)
    mean, deviation, best = begin, np.full(begin.shape, search.sigma), begin
    least, curve = np.full(len(begin), np.inf), []
    for _ in range(search.epochs):
        noise = rng.standard_normal((len(begin), search.candidates - 1, *begin.shape[1:]))
        knots = _on_sphere(np.concatenate([mean[:, None], mean[:, None] + deviation[:, None] * noise], axis=1))
        costs = play(spline(knots, steps), np.arange(search.starts))["costs"].mean(axis=-1)  # [seeds, candidates]
        order = np.argsort(costs, axis=1)[:, :ELITES]
        elites = np.take_along_axis(knots, order[..., None, None], axis=1)
        lowest = np.take_along_axis(costs, order[:, :1], axis=1)[:, 0]
        best = np.where((lowest < least)[:, None, None], elites[:, 0], best)
        least = np.minimum(least, lowest)
        mean, deviation = _on_sphere(elites.mean(axis=1)), np.maximum(elites.std(axis=1), LEAST)
        curve.append(lowest)
    return best, np.stack(curve, axis=1)


def _on_sphere(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-9)


def _player(trained: Trained, survey: Survey, course: Course, width: int, starts: int, seed: int) -> Play:
    """Returns what plays codes [seeds, ways, steps, code] from some of the starts, given by their numbers [count].

    It is compiled once, for `width` robots: those beyond ways · count are idle. On a path, the later half of the ways
    is by pursuit. The result has the course's `errors`, `costs` and `ends` [seeds, ways, count]; and for each step and
    robot, `outcome` with pose and code, and whether the episode is `over` [seeds, steps + 1, robots].
    """
    program, family = trained.program, trained.program.family
    seeds, steps = program.config.seeds, len(course.wanted)
    rings = np.stack([ring_of(survey, index, course) for index in range(seeds)]) if course.is_path else np.zeros(seeds)
    env, task = PoseEnv(family, resets=False), any_task(program.tasks.params)
    keys = jax.random.split(jax.random.key(seed), seeds)

    def of_seed(policy: Params, key: jax.Array, ring: jax.Array, codes: jax.Array, index: jax.Array) -> dict[str, Any]:
        begun = jax.tree.map(lambda leaf: leaf[:, index], env.start(key, task, starts))
        roll = Pursuit(program.agent, course, ring, family.dt).rollout if course.is_path else rollout
        along = jnp.swapaxes(codes, 0, 1)[:, None]  # [steps + 1, 1, robots, code]
        _, recorded = roll(env, act_along(program.agent, policy), begun, along, outcome_and_over)
        outcome, over = jax.tree.map(lambda leaf: leaf[:, 0], recorded)
        playing = (first_episode(over) & ~over)[:steps]
        of_steps = {name: outcome[name][:steps] for name in course.outcomes}
        measured = jax.vmap(partial(course.error, dt=family.dt), in_axes=1)(of_steps, playing)
        of_course = dict(zip(MEASURES, measured, strict=True))
        return {**of_course, "outcome": {"code": along[:, 0], **outcome}, "over": over}

    of_all = jax.jit(jax.vmap(of_seed, in_axes=(0, 0, 0, 0, None)), compiler_options=compiler_options())

    def play(codes: np.ndarray, index: np.ndarray) -> dict[str, Any]:
        ways, count = codes.shape[1], len(index)
        robots = np.arange(width) % (ways * count)
        along = np.concatenate([codes, codes[:, :, -1:]], axis=2)[:, robots // count]  # one more, for the last pose
        played = jax.device_get(of_all(trained.policies, keys, rings, along.astype(np.float32), index[robots % count]))
        used = {name: played[name][:, : ways * count].reshape(-1, ways, count) for name in MEASURES}
        return {**played, **used}

    return play


def ring_of(survey: Survey, index: int, course: Course) -> np.ndarray:
    """Returns codes [headings, code] that run in directions evenly spaced, at the speed of a path."""
    angles = 2 * np.pi * np.arange(HEADINGS) / HEADINGS
    wanted = course.speed * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return look_up(survey, index, replace(course, wanted=wanted), HEADINGS)


def _trajectory(program: Program, played: dict[str, Any], row: int) -> Trajectory:
    """Returns what the first seed's robot did in one way from the first start, until it had followed the course."""
    robot, shown = row * played["errors"].shape[2], slice(played["ends"][0, row, 0] + 1)
    names = ("qpos", *program.family.outcome_shapes)
    outcomes = {name: played["outcome"][name][0, shown, robot] for name in names}
    return until_over(program, outcomes, played["over"][0, shown, robot])


def _describe(
    trained: Trained,
    course: Course,
    names: tuple[str, ...],
    played: dict[str, Any],
    about: dict[str, np.ndarray],
) -> dict[str, Any]:
    """Describes the answers of both ways: errors from fresh starts, smoothness, and the course of the first start."""
    program = trained.program
    dt, steps, episodes = program.family.dt, len(course.wanted), played["errors"].shape[2]

    def way(index: int, row: int) -> dict[str, Any]:
        errors, over = played["errors"][index, row], played["over"][index, :steps]
        lasted = ~over[:, row * episodes : (row + 1) * episodes].any(axis=0)
        end = played["ends"][index, row, 0]
        codes, *columns = (played["outcome"][name][index, :end, row * episodes] for name in ("code", *course.outcomes))
        playing = np.cumsum(over[:end, row * episodes]) == 0
        followed = np.where(playing[:, None], np.stack(columns, axis=-1), 0.0)
        turns = 2 * np.arcsin(np.minimum(1, np.linalg.norm(codes[1:] - codes[:-1], axis=-1) / 2))
        beside = {"aside": np.round(played["costs"][index, row], 4).tolist()} if course.is_path else {}
        return {
            "error": round(float(errors.mean()), 4),
            "errors": np.round(errors, 4).tolist(),
            **beside,
            "lasted": float(lasted.mean()),
            "turn": round(float(turns.mean() / dt), 4) if len(turns) else 0.0,
            "followed": np.round(np.cumsum(followed, axis=0) * dt if course.is_path else followed, 3).tolist(),
            "ltes": np.round(codes, 5).tolist(),
        }

    seeds = [
        {
            "seed": program.config.seed + index,
            **{name: np.round(value[index], 5).tolist() for name, value in about.items()},
            "ways": {name: way(index, row) for row, name in enumerate(names)},
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
