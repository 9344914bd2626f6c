"""Adaptation to tasks never trained on: only the code is searched, the networks stay as they are."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp

from ear_jax.agents.networks import Params
from ear_jax.embeddings.map import PLACES, LteMap, check_reach, code_for_target, reaches, survey
from ear_jax.embeddings.search import Progress, Search, episodes_an_epoch, find_codes, reevaluate
from ear_jax.process.runtime import compiler_options
from ear_jax.runs.trained import Trained, for_each_seed
from ear_jax.runs.training import evaluation_keys
from ear_jax.tasks import Task, TaskSet


def adapt(
    trained: Trained, tasks: TaskSet, search: Search | None, episodes: int, seed: int, places: int = PLACES
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
      UsageError: only the map, and a target that no surveyed code comes near or an agent without a sphere of LTEs.
    """
    began = time.perf_counter()
    program, config = trained.program, trained.program.config
    mapped = search is None or (program.agent.embed is not None and program.agent.on_sphere)
    commanding = [(task, task.target) for task in tasks.tasks if task.target is not None and mapped]
    maps = survey(trained, places, 1, seed) if commanding else []
    if search is None:
        for _, target in commanding:
            check_reach(maps, program.family, target)
    answers = zero_shot(trained, maps, commanding, episodes, seed) if commanding else {}
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
    episodes_searched = len(tasks) * search.epochs * episodes_an_epoch(program, search) if search else 0
    seeds_steps = config.seeds * program.family.episode_length
    return {
        "tasks": found,
        "env_steps": seeds_steps * episodes_searched,
        "map_env_steps": seeds_steps * (places if maps else 0),
        "seconds": round(time.perf_counter() - began, 2),
    }


def _search_all(
    trained: Trained, tasks: TaskSet, search: Search, seed: int, episodes: int
) -> dict[tuple[int, str], dict[str, Any]]:
    """Every seed's search for every task in one call, by seed and task."""
    program, count = trained.program, trained.program.config.seeds

    def of_seed(policy: Params, key: jax.Array) -> Progress:
        return find_codes(program, policy, tasks.params, key, search, episodes)

    progress = for_each_seed(trained, of_seed, seed)

    def describe(index: int, row: int) -> dict[str, Any]:
        curves = {name: getattr(progress, name)[index, :, row] for name in ("best_of_epoch", "reevaluated", "achieved")}
        epochs = [{name: float(curve[epoch]) for name, curve in curves.items()} for epoch in range(search.epochs)]
        # A tuned code is as large as the policy, and found again sooner than read.
        return {"lte": None if program.agent.tuned else progress.code[index, -1, row].tolist(), "epochs": epochs}

    return {
        (program.config.seed + index, task.name): describe(index, row)
        for index in range(count)
        for row, task in enumerate(tasks.tasks)
    }


def zero_shot(
    trained: Trained,
    maps: Sequence[LteMap],
    commanding: Sequence[tuple[Task, float]],
    episodes: int,
    seed: int,
) -> dict[tuple[int, str], dict[str, Any]]:
    """For every seed, and every task that its map reaches, the code that the map promises and what it then achieves.

    Args:
      trained: the run.
      maps: the map of each seed.
      commanding: the tasks, each with what it commands.
      episodes: fresh episodes by which a code is judged.
      seed: of their starts.
    """
    program, family = trained.program, trained.program.family
    chosen = [[code_for_target(one, family, target) for _, target in commanding] for one in maps]
    codes = jnp.array([[code for code, _ in row] for row in chosen])
    params = TaskSet(tuple(task for task, _ in commanding)).params
    keys = evaluation_keys(jax.random.split(jax.random.key(seed), len(maps)), 0)

    def of_seed(policy: Params, codes: jax.Array, key: jax.Array) -> tuple[jax.Array, jax.Array]:
        return reevaluate(program, policy, codes, params, key, episodes)

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
        for index, one in enumerate(maps)
        for row, (task, target) in enumerate(commanding)
        if reaches(one, family, target)
    }
