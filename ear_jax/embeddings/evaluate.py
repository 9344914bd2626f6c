"""Evaluation: whole episodes from random starts, without exploration."""

from __future__ import annotations

import functools
from collections.abc import Callable
from functools import partial
from operator import itemgetter
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ear_jax.agents.networks import Params
from ear_jax.errors import UsageError
from ear_jax.learning.episodes import Episodes, achieved, play
from ear_jax.process.runtime import compiler_options
from ear_jax.runs import training
from ear_jax.runs.rollouts import check_rollouts
from ear_jax.runs.trained import Trained
from ear_jax.runs.training import Program, evaluation_keys
from ear_jax.tasks import any_task

KEPT = 4  # compiled functions of each kind, of programs and numbers of episodes


def play_codes(program: Program, policy: Params, codes: jax.Array, key: jax.Array, episodes: int) -> Episodes:
    """Plays one policy under any codes [rows, code], for the outcomes; the returns belong to no task in particular."""
    tasks = any_task(program.tasks.params, len(codes))
    return play(program.family, program.agent, policy, codes, tasks, key, episodes)


def evaluate(trained: Trained, episodes: int, seed: int) -> dict[str, Any]:
    """Plays every seed's policy on the training tasks.

    Args:
      trained: the run.
      episodes: episodes per task.
      seed: seeds the starts, which differ from those of training.

    Returns:
      The document that `ear evaluate --json` prints: per seed and task the return (mean, standard deviation), the mean
      outcome, the number of failed episodes (those that end before the time limit), and each episode. A task fails if
      any of its episodes fails. If codes are tuned (MAML), also `untuned_return`, the mean return from the same starts
      of the parameters that all tasks share.

    Raises:
      UsageError: no episodes.
      RunError: the episodes do not fit in memory.
    """
    _check_episodes(episodes)
    program = trained.program
    config, count = program.config, program.config.seeds
    check_rollouts(program, count * len(program.tasks) * episodes, program.family.episode_length)
    keys = evaluation_keys(jax.vmap(jax.random.fold_in, (None, 0))(jax.random.key(seed), jnp.arange(count)), 0)
    start, play_all = _compiled(program, episodes)
    starts = start(keys)
    played = jax.device_get(play_all(trained.policies, starts))
    seeds = [
        _describe_seed(program, config.seed + index, jax.tree.map(itemgetter(index), played)) for index in range(count)
    ]
    if program.agent.tuned:
        untuned = {**trained.policies, "codes": jnp.zeros_like(trained.policies["codes"])}
        shared = jax.device_get(play_all(untuned, starts).returns)
        seeds = [{**seed, "untuned_return": float(each.mean())} for seed, each in zip(seeds, shared, strict=True)]
    failures = [task["failures"] for seed in seeds for task in seed["tasks"]]
    return {
        "run": trained.name,
        "family": config.family,
        "agent": config.agent,
        "preset": config.preset,
        "engine": program.family.engine.name,
        "env_steps": trained.env_steps,
        "updates": trained.epoch * config.sac.updates,
        "episodes": episodes,
        "episode_length": program.family.episode_length,
        "commanded": program.family.quantity,
        "seeds": seeds,
        "mean_return": float(np.mean(played.returns)),
        "failed_tasks": {"failed": sum(count > 0 for count in failures), "total": len(failures)},
    }


@functools.lru_cache(maxsize=KEPT)
def _compiled(program: Program, episodes: int) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """Returns functions that start and play the evaluation of all seeds; a program that is asked again has them."""
    options = compiler_options()
    start = jax.jit(jax.vmap(lambda key: training.evaluation_starts(program, key, episodes)), compiler_options=options)
    return start, jax.jit(jax.vmap(partial(training.evaluate_from, program)), compiler_options=options)


def evaluate_code(trained: Trained, codes: jax.Array, episodes: int, seed: int) -> dict[str, Any]:
    """Plays every seed's policy under a given code.

    Args:
      trained: the run.
      codes: one for each seed, [seeds, code]; they are played projected onto the sphere, and reported as given.
      episodes: episodes per seed.
      seed: seeds the starts.

    Returns:
      The document that `ear evaluate --lte --json` prints.

    Raises:
      UsageError: codes of another shape or not finite, or no episodes.
      RunError: the episodes do not fit in memory.
    """
    program, family, codes = trained.program, trained.program.family, jnp.asarray(codes)
    shape = program.config.seeds, program.agent.code_size
    if jnp.shape(codes) != shape:
        raise UsageError(f"codes must have shape {shape}, one for each seed, but have {jnp.shape(codes)}")
    if not jnp.isfinite(codes).all():
        raise UsageError("codes must be finite")
    _check_episodes(episodes)
    check_rollouts(program, program.config.seeds * episodes, family.episode_length)

    keys = jax.random.split(jax.random.key(seed), program.config.seeds)
    played, reached = jax.device_get(_compiled_for_codes(program, episodes)(trained.policies, keys, codes))
    return {
        "run": trained.name,
        "episodes": episodes,
        "commanded": family.quantity,
        "seeds": [
            {
                "seed": program.config.seed + index,
                "lte": codes[index].tolist(),
                "length": float(played.lengths[index].mean()),
                "outcome": {
                    **{name: float(value[index].mean()) for name, value in played.late.items()},
                    family.commanded: float(reached[index, 0]),
                },
            }
            for index in range(program.config.seeds)
        ],
    }


@functools.lru_cache(maxsize=KEPT)
def _compiled_for_codes(program: Program, episodes: int) -> Callable[..., Any]:
    """Returns a function that plays every seed's policy under a code; a program that is asked again has it."""

    def of_seed(policy: Params, key: jax.Array, code: jax.Array) -> tuple[Episodes, jax.Array]:
        played = play_codes(program, policy, program.agent.project(code)[None], key, episodes)
        return played, achieved(program.family, played)

    return jax.jit(jax.vmap(of_seed), compiler_options=compiler_options())


def _check_episodes(episodes: int) -> None:
    if episodes < 1:
        raise UsageError(f"episodes {episodes} is too small; it must be at least 1")


def _describe_seed(program: Program, seed: int, played: Episodes) -> dict[str, Any]:
    """Turns one seed's episodes [tasks, episodes] into its part of the document.

    A task's achievement is computed from its episodes' mean outcomes, so that 359° and 1° average to 0°, not 180°.
    """
    family = program.family
    tasks = []
    for row, task in enumerate(program.tasks.tasks):
        late, whole = ({name: value[row] for name, value in means.items()} for means in (played.late, played.whole))
        mean_late, mean_whole = ({name: value.mean() for name, value in means.items()} for means in (late, whole))
        mean_late[family.commanded] = family.achieved(mean_late, mean_whole)
        tasks.append(
            {
                "name": task.name,
                "target": task.target,
                "return_mean": float(played.returns[row].mean()),
                "return_std": float(played.returns[row].std()),
                "failures": int((played.lengths[row] < family.episode_length).sum()),
                "outcome": {name: float(value) for name, value in mean_late.items()},
                "episodes": {
                    "return": played.returns[row].tolist(),
                    "length": played.lengths[row].tolist(),
                    **{name: value.tolist() for name, value in late.items()},
                    family.commanded: np.asarray(family.achieved(late, whole)).tolist(),
                },
            }
        )
    return {"seed": seed, "mean_return": float(played.returns.mean()), "tasks": tasks}
