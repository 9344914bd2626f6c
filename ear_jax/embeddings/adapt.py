"""Adaptation to tasks never trained on: only the code is searched, the networks stay unchanged."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp

from ear_jax.agents.networks import Params
from ear_jax.embeddings.map import PLACES, LteMap, check_reach, codes_for_targets, play_maps, reaches
from ear_jax.embeddings.search import Progress, Search, env_steps_an_epoch, find_codes, reevaluate
from ear_jax.envs import Family
from ear_jax.process.runtime import compiler_options
from ear_jax.runs.rollouts import check_rollouts
from ear_jax.runs.trained import Trained, for_each_seed
from ear_jax.runs.training import evaluation_keys
from ear_jax.tasks import Task, TaskSet


def adapt(
    trained: Trained,
    tasks: TaskSet,
    search: Search | None,
    episodes: int,
    seed: int,
    places: int = PLACES,
    within_reach: bool = False,
) -> dict[str, Any]:
    """Adapts every seed's policy to every task, by search and from a map of the LTE sphere.

    The map answers tasks whose target is within reach, if the agent has LTEs on a sphere.

    Args:
      trained: the run.
      tasks: the tasks.
      search: settings of the search; None: only the map.
      episodes: fresh episodes in which a code is evaluated.
      seed: seeds everything.
      places: number of codes on the map.
      within_reach: refuse a target that the map of no seed comes near, instead of searching for it.

    Returns:
      The document that `ear adapt --json` prints.

    Raises:
      UsageError: a target that no code on the map comes near, without a search or if asked; without a search, an
        agent that has no LTE sphere.
      RunError: the episodes do not fit in memory.
    """
    began = time.perf_counter()
    program, config = trained.program, trained.program.config
    check_sizes(trained, len(tasks), search, episodes)
    mapped = search is None or (program.agent.embed is not None and program.agent.on_sphere)
    targets = [(task, task.target) for task in tasks.tasks if task.target is not None and mapped]
    maps = play_maps(trained, places, 1, seed) if targets else []
    _check_targets(maps, program.family, [target for _, target in targets], search, within_reach)
    from_map = zero_shot(trained, maps, targets, episodes, seed) if targets else {}
    searched = search_all(trained, tasks, search, seed, episodes) if search else {}
    adapted = [
        {
            "seed": run_seed,
            "name": task.name,
            "target": task.target,
            "lte": (searched or from_map)[run_seed, task.name]["lte"],
            "epochs": searched[run_seed, task.name]["epochs"] if search else [],
            "zero_shot": from_map.get((run_seed, task.name)),
        }
        for run_seed in range(config.seed, config.seed + config.seeds)
        for task in tasks.tasks
    ]
    searched_steps = len(tasks) * search.epochs * env_steps_an_epoch(program, search) if search else 0
    mapped_steps = places * program.family.episode_length if maps else 0
    return {
        "tasks": adapted,
        "env_steps": config.seeds * searched_steps,
        "map_env_steps": config.seeds * mapped_steps,
        "seconds": round(time.perf_counter() - began, 2),
    }


def _check_targets(
    maps: Sequence[LteMap], family: Family, targets: Sequence[float], search: Search | None, within_reach: bool
) -> None:
    """Raises UsageError for a target out of reach: of any seed without a search, of all seeds if `within_reach`."""
    for target in targets:
        if search is None or (within_reach and not any(reaches(one, family, target) for one in maps)):
            check_reach(list(maps), family, target)


def check_sizes(trained: Trained, tasks: int, search: Search | None, episodes: int) -> None:
    """Raises RunError if a search or the episodes after it do not fit in memory."""
    program = trained.program
    at_once = max(search.candidates, episodes) if search else episodes
    kept = search.epochs * (program.agent.code_size + 5) if search else 0  # numbers that epochs leave behind
    steps = program.family.episode_length
    check_rollouts(program, program.config.seeds * tasks * at_once, steps, kept // (steps * at_once))


def search_all(
    trained: Trained, tasks: TaskSet, search: Search, seed: int, episodes: int
) -> dict[tuple[int, str], dict[str, Any]]:
    """Searches for all seeds and tasks in one compiled call; returns the results by seed and task."""
    program, count = trained.program, trained.program.config.seeds

    def of_seed(policy: Params, key: jax.Array) -> Progress:
        return find_codes(program, policy, tasks.params, key, search, episodes)

    progress = for_each_seed(trained, of_seed, seed)

    def describe(index: int, row: int) -> dict[str, Any]:
        curves = {name: getattr(progress, name)[index, :, row] for name in ("best_of_epoch", "reevaluated", "achieved")}
        epochs = [{name: float(curve[epoch]) for name, curve in curves.items()} for epoch in range(search.epochs)]
        # A tuned code is as large as the policy: finding it again takes less time than reading it.
        return {"lte": None if program.agent.tuned else progress.code[index, -1, row].tolist(), "epochs": epochs}

    return {
        (program.config.seed + index, task.name): describe(index, row)
        for index in range(count)
        for row, task in enumerate(tasks.tasks)
    }


def zero_shot(
    trained: Trained,
    maps: Sequence[LteMap],
    targets: Sequence[tuple[Task, float]],
    episodes: int,
    seed: int,
) -> dict[tuple[int, str], dict[str, Any]]:
    """Chooses codes from the maps, plays them, and returns their predictions and achievements by seed and task.

    A task is left out for the seeds whose map does not reach its target.

    Args:
      trained: the run.
      maps: the map of each seed.
      targets: the tasks with their targets.
      episodes: fresh episodes in which a code is evaluated.
      seed: seeds their starts.
    """
    program, family = trained.program, trained.program.family
    chosen = [codes_for_targets(lte_map, family, [target for _, target in targets]) for lte_map in maps]
    codes = jnp.array([[code for code, _ in row] for row in chosen])
    params = TaskSet(tuple(task for task, _ in targets)).params
    keys = evaluation_keys(jax.random.split(jax.random.key(seed), len(maps)), 0)

    def of_seed(policy: Params, codes: jax.Array, key: jax.Array) -> tuple[jax.Array, jax.Array]:
        return reevaluate(program, policy, codes, params, key, episodes)

    of_all = jax.jit(jax.vmap(of_seed), compiler_options=compiler_options())
    returns, achieved = jax.device_get(of_all(trained.policies, codes, keys))
    return {
        (program.config.seed + index, task.name): {
            "lte": codes[index, row].tolist(),
            "predicted": chosen[index][row][1],
            "achieved": float(achieved[index, row]),
            "error": abs(float(family.difference(achieved[index, row], target))),
            "reevaluated": float(returns[index, row]),
        }
        for index, lte_map in enumerate(maps)
        for row, (task, target) in enumerate(targets)
        if reaches(lte_map, family, target)
    }
