"""LTEs for any reward, from a survey of the sphere, from an imagined one and by search, each played again."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ear_jax.agents.networks import Params
from ear_jax.embeddings.adapt import check_sizes, search_all
from ear_jax.embeddings.imagine import Imagined, best_imagined, find_imagined
from ear_jax.embeddings.search import Search, env_steps_an_epoch
from ear_jax.embeddings.survey import PLACES, codes_for_returns, find_survey, returns_of
from ear_jax.envs.asked import Reward, asked, reward_functions, score_outcomes
from ear_jax.envs.family import Outcome
from ear_jax.errors import UsageError
from ear_jax.learning.episodes import late_steps, record_from, starts
from ear_jax.process.runtime import compiler_options
from ear_jax.runs.rollouts import check_rollouts
from ear_jax.runs.trained import Trained
from ear_jax.runs.training import evaluation_keys
from ear_jax.tasks import TaskSet, any_task


@dataclass(frozen=True)
class Answers:
    """The answers of one way to several rewards, for every seed's policy."""

    codes: np.ndarray  # [seeds, rewards, code]
    predicted: np.ndarray  # [seeds, rewards], the return expected
    env_steps: int  # that they took
    epochs: list[list[list[dict[str, float]]]] | None = None  # of a search, by seed and reward


def adapt_to_rewards(
    trained: Trained,
    rewards: Sequence[Reward | str],
    search: Search | None = None,
    episodes: int = 5,
    seed: int = 0,
    places: int = PLACES,
) -> dict[str, Any]:
    """Finds for every seed's policy the LTE that returns most for each reward, in every way there is.

    The ways are a survey of the sphere, if LTEs lie on one, which takes no environment step once it is kept; the
    imagined sphere, if `ear imagine` was run; and a search. A return is the sum of rewards over an episode.

    Args:
      trained: the run.
      rewards: expressions over the family's outcomes, or functions of one outcome.
      search: settings of the search; None: no search.
      episodes: fresh episodes in which each answer is played again, from the same starts for all ways.
      seed: seeds everything.
      places: number of codes of the survey.

    Returns:
      The document that `ear adapt --reward --json` prints.

    Raises:
      UsageError: a reward has a mistake or is not finite; without a search, an agent that has no LTE sphere; an agent
        without codes of its own.
      RunError: the episodes do not fit in memory.
    """
    program = trained.program
    if program.agent.tuned:
        raise UsageError(f"agent {program.config.agent} has no LTEs; --reward finds LTEs")
    functions = reward_functions(program.family, rewards)
    family, tasks = asked(program.family, functions)
    asking = replace(trained, program=replace(program, family=family))
    check_sizes(asking, len(tasks), search, episodes)
    ways: dict[str, Callable[[], Answers]] = {}
    if search is None or (program.agent.embed is not None and program.agent.on_sphere):
        ways["map"] = lambda: _from_survey(trained, functions, places, seed)
    if imagined := find_imagined(trained):
        ways["imagined"] = lambda: _from_imagined(imagined, functions, program.family.episode_length)
    if search:
        ways["search"] = lambda: _by_search(asking, tasks, search, episodes, seed)
    answers, seconds = {}, {}
    for way, find in ways.items():
        began = time.perf_counter()
        answers[way] = find()
        seconds[way] = round(time.perf_counter() - began, 2)
    costs = {way: {"env_steps": found.env_steps, "seconds": seconds[way]} for way, found in answers.items()}
    played = _play_again(trained, functions, np.stack([found.codes for found in answers.values()], 1), episodes, seed)
    return {"tasks": _describe(trained, tasks.names, answers, *played), "costs": costs, "episodes": episodes}


def _from_survey(trained: Trained, rewards: Sequence[Reward], places: int, seed: int) -> Answers:
    survey, env_steps = find_survey(trained, places, seed)
    returns = np.stack([returns_of(survey, reward) for reward in rewards], axis=-1)  # [seeds, places, rewards]
    codes, predicted = zip(*(codes_for_returns(survey.codes, of_seed) for of_seed in returns), strict=True)
    return Answers(np.stack(codes), np.stack(predicted), env_steps)


def _from_imagined(imagined: Imagined, rewards: Sequence[Reward], steps: int) -> Answers:
    codes, predicted = zip(*(best_imagined(imagined, reward, steps) for reward in rewards), strict=True)
    return Answers(np.stack(codes, axis=1), np.stack(predicted, axis=1), 0)


def _by_search(asking: Trained, tasks: TaskSet, search: Search, episodes: int, seed: int) -> Answers:
    program = asking.program
    found = search_all(asking, tasks, search, seed, episodes)
    rows = [[found[program.config.seed + index, name] for name in tasks.names] for index in range(program.config.seeds)]
    epochs = [[cell["epochs"] for cell in row] for row in rows]
    last = np.array([[curve[-1]["best_of_epoch"] for curve in row] for row in epochs])
    played = program.config.seeds * len(tasks) * search.epochs * env_steps_an_epoch(program, search)
    codes = np.array([[cell["lte"] for cell in row] for row in rows])
    return Answers(codes, last, played, epochs)


def _describe(
    trained: Trained,
    rewards: Sequence[str],
    answers: dict[str, Answers],
    returns: np.ndarray,
    late: dict[str, np.ndarray],
) -> list[dict[str, Any]]:
    """Returns a document for each seed and reward; the answer that returned most when played again gives its LTE.

    That return is the highest of those of all ways in the same episodes, so chance flatters it a little.
    """
    program, ways = trained.program, list(answers)

    def answer(way: str, index: int, row: int) -> dict[str, Any]:
        place = index, ways.index(way), row
        return {
            "lte": answers[way].codes[index, row].tolist(),
            "predicted": float(answers[way].predicted[index, row]),
            "reevaluated": float(returns[place]),
            "outcome": {name: float(value[place]) for name, value in late.items()},
        }

    def describe(index: int, row: int) -> dict[str, Any]:
        found = {way: answer(way, index, row) for way in ways}
        best = max(found, key=lambda way: found[way]["reevaluated"])
        epochs = next((one.epochs[index][row] for one in answers.values() if one.epochs), [])
        about = {"seed": program.config.seed + index, "name": rewards[row], "target": None}
        return {**about, "lte": found[best]["lte"], "best": best, "epochs": epochs, "answers": found}

    return [describe(index, row) for index in range(program.config.seeds) for row in range(len(rewards))]


def _play_again(
    trained: Trained, rewards: Sequence[Reward], codes: np.ndarray, episodes: int, seed: int
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Plays codes [seeds, ways, rewards, code] in fresh episodes, all from the same starts.

    Returns:
      Mean returns, and mean outcomes over the second half of the episodes by name, each [seeds, ways, rewards].

    Raises:
      UsageError: a reward is not finite in these episodes.
      RunError: the episodes do not fit in memory.
    """
    program, steps = trained.program, trained.program.family.episode_length
    check_rollouts(program, math.prod(codes.shape[:3]) * episodes, steps, len(program.family.outcome_shapes))
    tasks = any_task(program.tasks.params, len(rewards))
    still = jnp.zeros((steps, len(rewards), episodes, program.family.action_size))
    keys = evaluation_keys(jax.random.split(jax.random.key(seed), len(codes)), 0)

    def of_way(policy: Params, codes: jax.Array, key: jax.Array) -> tuple[Outcome, jax.Array]:
        begun = starts(program.family, tasks, key, episodes)
        return record_from(program.family, program.agent, policy, codes, begun, still)

    of_all = jax.jit(jax.vmap(jax.vmap(of_way, in_axes=(None, 0, None))), compiler_options=compiler_options())
    # Outcomes, and whether a step is part of an episode: [seeds, ways, steps, rewards, episodes].
    outcomes, playing = jax.device_get(of_all(trained.policies, jnp.asarray(codes), keys))
    returns = [
        score_outcomes(reward, {name: value[..., row, :] for name, value in outcomes.items()}, playing[..., row, :])
        for row, reward in enumerate(rewards)
    ]
    late = np.moveaxis(late_steps(playing.sum(axis=2), steps), -1, 2)
    counts = np.maximum(late.sum(axis=2), 1)
    means = {name: (np.where(late, value, 0.0).sum(axis=2) / counts).mean(-1) for name, value in outcomes.items()}
    return np.stack([of_steps.sum(axis=2).mean(axis=-1) for of_steps in returns], axis=-1), means
