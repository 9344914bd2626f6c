"""LTEs for any reward, from a survey of the sphere, from an imagined one and by search, each played again."""

from __future__ import annotations

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
from ear_jax.embeddings.search import Search, episodes_an_epoch
from ear_jax.embeddings.survey import PLACES, codes_for_returns, find_survey, returns_of
from ear_jax.envs.asked import Reward, asked, reward_functions
from ear_jax.errors import UsageError
from ear_jax.learning.episodes import Episodes, play
from ear_jax.process.runtime import compiler_options
from ear_jax.runs.trained import Trained
from ear_jax.runs.training import evaluation_keys
from ear_jax.tasks import TaskSet


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
    return {"tasks": _describe(asking, tasks, answers, episodes, seed), "costs": costs, "episodes": episodes}


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
    played = program.config.seeds * len(tasks) * search.epochs * episodes_an_epoch(program, search)
    codes = np.array([[cell["lte"] for cell in row] for row in rows])
    return Answers(codes, last, played * program.family.episode_length, epochs)


def _describe(
    asking: Trained, tasks: TaskSet, answers: dict[str, Answers], episodes: int, seed: int
) -> list[dict[str, Any]]:
    """Plays all answers again and returns a document for each seed and reward; the best answer gives its LTE."""
    program, ways = asking.program, list(answers)
    codes = np.stack([found.codes for found in answers.values()], axis=1)  # [seeds, ways, rewards, code]
    returns, late = _play_again(asking, codes, tasks, episodes, seed)

    def answer(way: str, index: int, row: int) -> dict[str, Any]:
        place = index, ways.index(way), row
        return {
            "lte": codes[place].tolist(),
            "predicted": float(answers[way].predicted[index, row]),
            "reevaluated": float(returns[place]),
            "outcome": {name: float(value[place]) for name, value in late.items()},
        }

    def describe(index: int, row: int) -> dict[str, Any]:
        found = {way: answer(way, index, row) for way in ways}
        best = max(found, key=lambda way: found[way]["reevaluated"])
        epochs = next((one.epochs[index][row] for one in answers.values() if one.epochs), [])
        about = {"seed": program.config.seed + index, "name": tasks.names[row], "target": None}
        return {**about, "lte": found[best]["lte"], "best": best, "epochs": epochs, "answers": found}

    return [describe(index, row) for index in range(program.config.seeds) for row in range(len(tasks))]


def _play_again(
    asking: Trained, codes: np.ndarray, tasks: TaskSet, episodes: int, seed: int
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Plays codes [seeds, ways, rewards, code] in fresh episodes, all from the same starts.

    Returns:
      Mean returns, and mean outcomes over the second half of the episodes by name, each [seeds, ways, rewards].
    """
    program = asking.program
    keys = evaluation_keys(jax.random.split(jax.random.key(seed), len(codes)), 0)

    def of_way(policy: Params, codes: jax.Array, key: jax.Array) -> Episodes:
        return play(program.family, program.agent, policy, codes, tasks.params, key, episodes)

    of_all = jax.vmap(jax.vmap(of_way, in_axes=(None, 0, None)))
    played = jax.jit(of_all, compiler_options=compiler_options())(asking.policies, jnp.asarray(codes), keys)
    returns, late = jax.device_get((played.returns, played.late))
    return returns.mean(axis=-1), {name: value.mean(axis=-1) for name, value in late.items()}
