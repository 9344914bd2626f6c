"""Adaptation to tasks never trained on: only the code is searched, the networks stay as they are."""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from ear_jax import cem
from ear_jax.evaluate import play
from ear_jax.networks import Params
from ear_jax.runtime import compiler_options
from ear_jax.tasks import TaskParams, TaskSet
from ear_jax.train import Program
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
        again = play(family, agent, policy, best, tasks, key_again, episodes)
        return state, Progress(returns.max(axis=1), again.returns.mean(axis=1), best)

    state = jax.vmap(begin)(jax.random.split(key_init, count))
    return jax.lax.scan(epoch, state, jax.random.split(key_epochs, search.epochs))[1]


def adapt(trained: Trained, tasks: TaskSet, search: Search, episodes: int, seed: int) -> dict[str, Any]:
    """Adapts every seed's policy to every task; what `ear adapt --json` prints."""
    began = time.perf_counter()
    program, count = trained.program, trained.program.config.seeds
    keys = jax.random.split(jax.random.key(seed), count)

    def of_seed(policy: Params, key: jax.Array) -> Progress:
        return search_codes(program, policy, tasks.params, key, search, episodes)

    progress = jax.device_get(jax.jit(jax.vmap(of_seed), compiler_options=compiler_options())(trained.policies, keys))
    found = [
        {
            "seed": program.config.seed + index,
            "name": task.name,
            "target": task.target,
            "lte": progress.code[index, -1, row].tolist(),
            "epochs": [
                {
                    "best_of_epoch": float(progress.best_of_epoch[index, epoch, row]),
                    "reevaluated": float(progress.reevaluated[index, epoch, row]),
                }
                for epoch in range(search.epochs)
            ],
        }
        for index in range(count)
        for row, task in enumerate(tasks.tasks)
    ]
    steps = count * len(tasks) * search.epochs * search.candidates * program.family.episode_length
    return {"tasks": found, "env_steps": steps, "seconds": round(time.perf_counter() - began, 2)}
