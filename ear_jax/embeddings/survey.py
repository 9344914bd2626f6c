"""Surveys of the LTE sphere that keep the outcomes of every step, from which any reward is answered without a roll-out.

A survey stands beside the run, as `survey_places-2000.safetensors`, and is used again while the policy is the same.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from ear_jax.agents.networks import Params
from ear_jax.embeddings.codes import spread_codes
from ear_jax.embeddings.kept import Shape, read_kept, write_kept
from ear_jax.embeddings.map import FINE, check_sphere
from ear_jax.embeddings.smooth import smooth_best
from ear_jax.envs.asked import Reward, score_outcomes
from ear_jax.envs.family import Outcome
from ear_jax.errors import RunError
from ear_jax.learning.episodes import record_from, starts
from ear_jax.process.terminal import say
from ear_jax.runs.rollouts import check_rollouts
from ear_jax.runs.trained import Trained, for_each_seed
from ear_jax.tasks import any_task

PLACES = 2000  # codes played, 0.08 radians apart on a sphere in three dimensions
FORMAT = "ear_jax survey 1"


@dataclass(frozen=True)
class Survey:
    """One episode of every seed's policy under each of the codes spread over the sphere."""

    codes: np.ndarray  # [places, code]
    outcomes: dict[str, np.ndarray]  # by name [seeds, places, steps], in order of time
    lengths: np.ndarray  # int32 [seeds, places], steps until the episode ended; later outcomes do not count

    @property
    def steps(self) -> int:
        """Steps of an episode that lasts."""
        return int(next(iter(self.outcomes.values())).shape[-1])


def find_survey(trained: Trained, places: int, seed: int) -> tuple[Survey, int]:
    """Returns the survey that is kept beside a run, or else plays it and keeps it.

    Args:
      trained: the run.
      places: number of codes.
      seed: seeds the starts.

    Returns:
      The survey, and the environment steps it took now: 0 for one that was kept.

    Raises:
      UsageError, RunError: as `play_survey`.
    """
    check_sphere(trained)
    family, seeds = trained.program.family, trained.program.config.seeds
    path = trained.directory / f"survey_places-{places}{f'_random-{seed}' * (seed != 0)}.safetensors"
    steps: dict[str, Shape] = {
        f"outcome.{name}": (seeds, places, family.episode_length) for name in family.outcome_shapes
    }
    shapes = {**steps, "codes": (places, trained.program.agent.code_size), "lengths": (seeds, places)}
    if path.is_file():
        try:
            arrays = read_kept(path, shapes, trained, FORMAT)
            outcomes = {name: arrays[f"outcome.{name}"] for name in family.outcome_shapes}
            return Survey(arrays["codes"], outcomes, arrays["lengths"]), 0
        except RunError as error:
            say(f"{error}; the sphere is surveyed again")
    survey = play_survey(trained, places, seed)
    arrays = {f"outcome.{name}": value for name, value in survey.outcomes.items()}
    try:
        write_kept(path, {**arrays, "codes": survey.codes, "lengths": survey.lengths}, trained, FORMAT)
    except RunError as error:
        say(f"warning: the survey is not kept: {error}")
    return survey, survey.lengths.size * trained.program.family.episode_length


def play_survey(trained: Trained, places: int, seed: int) -> Survey:
    """Plays every seed's policy for one episode under each code; arguments as in `find_survey`.

    Raises:
      UsageError: the agent has no LTEs, or they do not lie on a sphere.
      RunError: the episodes do not fit in memory.
    """
    check_sphere(trained)
    codes = spread_codes(places, trained.program.agent.code_size)
    outcomes, lengths = record_codes(
        trained, np.broadcast_to(codes, (trained.program.config.seeds, *codes.shape)), seed
    )
    return Survey(codes, outcomes, lengths)


def record_codes(trained: Trained, codes: np.ndarray, seed: int) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Plays one episode under each code [seeds, places, code]; returns outcomes and lengths as `Survey` has them.

    Raises:
      RunError: the episodes do not fit in memory.
    """
    program, places = trained.program, codes.shape[1]
    family, agent, steps = program.family, program.agent, program.family.episode_length
    check_rollouts(program, program.config.seeds * places, steps, len(family.outcome_shapes))
    tasks = any_task(program.tasks.params, places)

    def of_seed(policy: Params, key: jax.Array, codes: jax.Array) -> tuple[Outcome, jax.Array]:
        begun, still = starts(family, tasks, key, 1), jnp.zeros((steps, places, 1, family.action_size))
        outcome, playing = record_from(family, agent, policy, codes, begun, still)
        return jax.tree.map(lambda leaf: leaf[..., 0].T, outcome), jnp.sum(playing, axis=0)[:, 0]

    outcomes, lengths = for_each_seed(trained, of_seed, seed, jnp.asarray(codes))
    return {name: np.asarray(value, np.float32) for name, value in outcomes.items()}, lengths


def returns_of(survey: Survey, reward: Reward) -> np.ndarray:
    """Returns what each surveyed episode returns for a reward, [seeds, places].

    Raises:
      UsageError: the reward of some surveyed outcome is not a finite number.
    """
    playing = np.arange(survey.steps) < survey.lengths[..., None]
    return score_outcomes(reward, survey.outcomes, playing).sum(axis=-1, dtype=np.float64)


def codes_for_returns(codes: np.ndarray, returns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Chooses for each reward the code expected to return most.

    Args:
      codes: the surveyed codes [places, code].
      returns: what they returned, [places, rewards].

    Returns:
      The codes [rewards, code] and their expected returns [rewards].
    """
    candidates = spread_codes(FINE, codes.shape[1])
    expected = smooth_best(codes, returns, candidates)
    return candidates[expected.argmax(axis=0)], expected.max(axis=0)
