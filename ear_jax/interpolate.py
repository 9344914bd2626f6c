"""Interpolation and extrapolation between trained tasks: every pair, every β, every episode in one compiled call."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ear_jax.codes import blend, slerp
from ear_jax.evaluate import Episodes, play
from ear_jax.networks import Params
from ear_jax.runtime import compiler_options
from ear_jax.train import Program
from ear_jax.trained import Trained

BETAS = tuple(round(0.01 * step, 2) for step in range(1, 100))
MID_TASK_RANGE = (0.1, 0.9)  # where the paper looks for a suitable β
# The paper does not say how near is reached; its tables count 1.60 for 1.5 m/s as a miss and 9.51 for 9.5 as a hit.
REACHED = 0.05  # of the distance between the two tasks
Pair = tuple[int, int]


def adjacent_pairs(program: Program) -> list[Pair]:
    """Neighbours among the training tasks that command something; where it wraps, the last and the first too."""
    tasks = program.tasks.tasks
    order = sorted((task.target, row) for row, task in enumerate(tasks) if task.target is not None)
    pairs = [(one, other) for (_, one), (_, other) in pairwise(order)]
    if len(order) > 2:
        (first, first_row), (last, last_row) = order[0], order[-1]
        if program.family.difference(first, last) != first - last:
            pairs.append((last_row, first_row))
    return pairs


def play_blends(
    trained: Trained, pairs: Sequence[Pair], betas: Sequence[float], episodes: int, seed: int, along: str = "chord"
) -> np.ndarray:
    """What each blend achieves, [seeds, pairs, betas], in the commanded quantity, from the episodes' mean outcomes.

    Args:
      trained: the run.
      pairs: rows of the code table.
      betas: β of equation 1; outside [0, 1] it extrapolates.
      episodes: how many a blend.
      seed: of the starts.
      along: `chord`, the paper's normalised sum, or `arc`, the great circle.
    """
    program, first, second = trained.program, *np.array(pairs).T
    family, agent = program.family, program.agent

    def of_seed(policy: Params, key: jax.Array) -> Episodes:
        table = agent.codes(policy)

        def between(one: jax.Array, other: jax.Array, beta: jax.Array) -> jax.Array:
            return slerp(one, other, beta) if along == "arc" else blend(one, other, beta, agent.project)

        over_betas = jax.vmap(between, in_axes=(None, None, 0))
        codes = jax.vmap(over_betas, in_axes=(0, 0, None))(table[first], table[second], jnp.array(betas))
        rows = codes.reshape(-1, agent.code_size)
        # An outcome does not depend on the task it is scored for; any will do.
        tasks = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf[0], len(rows)), program.tasks.params)
        return play(family, agent, policy, rows, tasks, key, episodes)

    keys = jax.random.split(jax.random.key(seed), program.config.seeds)
    played = jax.device_get(jax.jit(jax.vmap(of_seed), compiler_options=compiler_options())(trained.policies, keys))
    late, whole = ({name: value.mean(-1) for name, value in means.items()} for means in (played.late, played.whole))
    return np.asarray(family.achieved(late, whole)).reshape(-1, len(pairs), len(betas))


def interpolate(
    trained: Trained, pairs: Sequence[Pair], target: float | None, episodes: int, seed: int, along: str = "chord"
) -> dict[str, Any]:
    """For every seed and pair the β that best meets the target, and the paper's two measures of success.

    Args:
      trained: the run.
      pairs: rows of the code table.
      target: what to meet; None: midway between the two.
      episodes, seed, along: as in `play_blends`.

    Returns:
      What `ear interpolate --json` prints.
    """
    achieved = play_blends(trained, pairs, BETAS, episodes, seed, along)
    tasks, family = trained.program.tasks.tasks, trained.program.family
    found = [
        {"seed": trained.program.config.seed + index, **_judge(family, tasks[one], tasks[other], row, target)}
        for index, rows in enumerate(achieved)
        for (one, other), row in zip(pairs, rows, strict=True)
    ]

    def count(what: str) -> dict[str, int]:
        return {"success": sum(pair[what] for pair in found), "total": len(found)}

    return {"pairs": found, "mid_task": count("mid_task"), "one_to_one": count("one_to_one")}


def _judge(family: Any, one: Any, other: Any, achieved: np.ndarray, target: float | None) -> dict[str, Any]:
    """One pair's blends [betas]: `achieved` at β of `BETAS`."""
    betas = np.array(BETAS)
    gap = family.difference(other.target, one.target)
    middle = one.target + gap / 2
    wanted = middle if target is None else target
    best = int(np.argmin(np.abs(family.difference(achieved, wanted))))
    inside = (betas > MID_TASK_RANGE[0]) & (betas < MID_TASK_RANGE[1])
    halfway = achieved[BETAS.index(0.5)]
    share = family.difference(halfway, one.target) / gap  # 0 at one task, 1 at the other
    return {
        "between": [one.name, other.name],
        "target": wanted,
        "beta": BETAS[best],
        "outcome": float(achieved[best]),
        "mid_task": bool((np.abs(family.difference(achieved, middle))[inside] <= REACHED * abs(gap)).any()),
        "one_to_one": bool(0 < share < 1),
        "one_to_one_outcome": float(halfway),
    }
