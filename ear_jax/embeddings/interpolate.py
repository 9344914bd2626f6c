"""Interpolation and extrapolation between trained tasks: every pair, every β, every episode in one compiled call."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ear_jax.agents import Agent
from ear_jax.agents.networks import Params
from ear_jax.embeddings.codes import blend, slerp
from ear_jax.embeddings.evaluate import play_codes
from ear_jax.envs import Family
from ear_jax.errors import UsageError
from ear_jax.learning.episodes import achieved
from ear_jax.runs.trained import Trained, for_each_seed

BETAS = tuple(round(0.01 * step, 2) for step in range(1, 100))
MID_TASK_RANGE = (0.1, 0.9)  # where the paper looks for a suitable β
# The paper does not say how near is reached; its tables count 1.60 for 1.5 m/s as a miss and 9.51 for 9.5 as a hit.
REACHED = 0.05  # of the distance between the two tasks


@dataclass(frozen=True)
class End:
    """One end of an interpolation: a code a seed, and what it is for."""

    name: str
    target: float | None
    codes: np.ndarray  # [seeds, code]


Pair = tuple[End, End]


def trained_ends(trained: Trained) -> list[End]:
    """The training tasks' codes, in their order."""
    table = np.asarray(jax.vmap(trained.program.agent.codes)(trained.policies))
    return [End(task.name, task.target, table[:, row]) for row, task in enumerate(trained.program.tasks.tasks)]


def adjacent_pairs(ends: Sequence[End], family: Family) -> list[Pair]:
    """Neighbours among those that command something; where that wraps, the last and the first too."""
    order = sorted((end for end in ends if end.target is not None), key=lambda end: end.target or 0.0)
    pairs = list(pairwise(order))
    if family.period is not None and len(order) > 2:
        pairs.append((order[-1], order[0]))
    return pairs


def between(agent: Agent, along: str) -> Callable[[jax.Array, jax.Array, jax.Array], jax.Array]:
    """The way from one code to another, as a function of both and of β.

    Args:
      agent: whose codes.
      along: `chord`, the paper's normalised sum, or `arc`, the great circle.

    Raises:
      UsageError: the arc, and codes that do not lie on a sphere.
    """
    if along == "chord":
        return partial(blend, project=agent.project)
    if not agent.on_sphere:
        raise UsageError("--along arc needs codes on a sphere, and this run's are not; --along chord is the other way")
    return slerp


def play_blends(
    trained: Trained, pairs: Sequence[Pair], betas: Sequence[float], episodes: int, seed: int, along: str = "chord"
) -> np.ndarray:
    """What each blend achieves, [seeds, pairs, betas], in the commanded quantity, from the episodes' mean outcomes.

    Args:
      trained: the run.
      pairs: between what.
      betas: β of equation 1; outside [0, 1] it extrapolates.
      episodes: how many a blend.
      seed: of the starts.
      along: as `between`'s.

    Raises:
      UsageError: no pairs, or no such way between their codes.
    """
    if not pairs:
        raise UsageError(f"{trained.name} has no two tasks that command a {trained.program.family.commanded}")
    program, agent = trained.program, trained.program.agent
    firsts, seconds = (jnp.stack([end.codes for end in ends], axis=1) for ends in zip(*pairs, strict=True))

    over_betas = jax.vmap(between(agent, along), in_axes=(None, None, 0))

    def of_seed(policy: Params, key: jax.Array, first: jax.Array, second: jax.Array) -> jax.Array:
        codes = jax.vmap(over_betas, in_axes=(0, 0, None))(first, second, jnp.array(betas))
        played = play_codes(program, policy, codes.reshape(-1, agent.code_size), key, episodes)
        return achieved(program.family, played)

    return for_each_seed(trained, of_seed, seed, firsts, seconds).reshape(-1, len(pairs), len(betas))


def interpolate(
    trained: Trained, pairs: Sequence[Pair], target: float | None, episodes: int, seed: int, along: str = "chord"
) -> dict[str, Any]:
    """For every seed and pair the β that best meets the target, and the paper's two measures of success.

    Args:
      trained: the run.
      pairs: between what; both ends command something.
      target: what to meet; None: midway between the two.
      episodes, seed, along: as in `play_blends`.

    Returns:
      What `ear interpolate --json` prints.

    Raises:
      UsageError: as `play_blends`, or a target that lies outside what the blends achieve.
    """
    reached = play_blends(trained, pairs, BETAS, episodes, seed, along)
    family = trained.program.family
    if target is not None:
        _check_reach(family, pairs[0], reached, target)
    found = [
        {"seed": trained.program.config.seed + index, **_score_pair(family, one, other, row, target)}
        for index, rows in enumerate(reached)
        for (one, other), row in zip(pairs, rows, strict=True)
    ]

    def count(what: str) -> dict[str, int]:
        return {"success": sum(pair[what] for pair in found), "total": len(found)}

    counts = {"mid_task": count("mid_task"), "one_to_one": count("one_to_one")}
    return {"pairs": found, **counts, "betas": BETAS, "commanded": family.quantity}


def _check_reach(family: Family, pair: Pair, reached: np.ndarray, target: float) -> None:
    """Refuses a target further from every blend than its ends are from one another."""
    gap = abs(family.difference(pair[0].target, pair[1].target))
    if np.abs(family.difference(reached, target)).min() > gap:
        span = f"{reached.min():.2f} to {reached.max():.2f} {family.unit}"
        raise UsageError(f"no blend of {pair[0].name} and {pair[1].name} comes near {target:g}; they reach {span}")


def _score_pair(family: Family, one: End, other: End, reached: np.ndarray, target: float | None) -> dict[str, Any]:
    """One pair's blends [betas]: `reached` at β of `BETAS`."""
    betas = np.array(BETAS)
    gap = family.difference(other.target, one.target)
    middle = one.target + gap / 2
    wanted = middle if target is None else target
    best = int(np.argmin(np.abs(family.difference(reached, wanted))))
    inside = (betas > MID_TASK_RANGE[0]) & (betas < MID_TASK_RANGE[1])
    halfway = reached[BETAS.index(0.5)]
    share = family.difference(halfway, one.target) / gap  # 0 at one task, 1 at the other
    return {
        "between": [one.name, other.name],
        "target": wanted,
        "beta": BETAS[best],
        "outcome": float(reached[best]),
        "mid_task": bool((np.abs(family.difference(reached, middle))[inside] <= REACHED * abs(gap)).any()),
        "one_to_one": bool(0 < share < 1),
        "one_to_one_outcome": float(halfway),
        "curve": [round(float(value), 4) for value in reached],
    }
