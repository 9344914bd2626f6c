"""Interpolation and extrapolation between trained tasks: all pairs, β and episodes in one compiled call."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from ear_jax.agents import Agent
from ear_jax.agents.networks import Params
from ear_jax.embeddings.codes import blend, slerp
from ear_jax.embeddings.evaluate import play_codes
from ear_jax.envs import Family
from ear_jax.errors import UsageError
from ear_jax.learning.episodes import achieved
from ear_jax.runs.rollouts import check_rollouts
from ear_jax.runs.trained import Trained, for_each_seed

BETAS = tuple(round(0.01 * step, 2) for step in range(1, 100))
MID_TASK_RANGE = (0.1, 0.9)  # in which the paper looks for a suitable β
# The paper gives no tolerance; its tables count 1.60 for 1.5 m/s as a miss and 9.51 for 9.5 as a hit.
REACHED = 0.05  # of the distance between the two tasks
FRESH = 10  # episodes in which the blend found is played again
AGAIN = 0x0A6A1  # keeps their starts apart from those of the search


@dataclass(frozen=True)
class End:
    """One end of an interpolation: the code of a task or of a saved LTE, for every seed."""

    name: str
    target: float | None
    codes: np.ndarray  # [seeds, code]


Pair = tuple[End, End]


def trained_ends(trained: Trained) -> list[End]:
    """Returns the codes of the training tasks, in the order of the tasks."""
    table = np.asarray(jax.vmap(trained.program.agent.codes)(trained.policies))
    return [End(task.name, task.target, table[:, row]) for row, task in enumerate(trained.program.tasks.tasks)]


def adjacent_pairs(ends: Sequence[End], family: Family) -> list[Pair]:
    """Pairs each task that has a target with the next higher; if the quantity wraps, also the last with the first.

    Tasks with equal targets have nothing between them and are no pair.
    """
    order = sorted((end for end in ends if end.target is not None), key=lambda end: end.target or 0.0)
    pairs = list(pairwise(order))
    if family.period is not None and len(order) > 2:
        pairs.append((order[-1], order[0]))
    return [pair for pair in pairs if family.difference(pair[0].target, pair[1].target)]


def between(agent: Agent, along: str) -> Callable[[jax.Array, jax.Array, jax.Array], jax.Array]:
    """Returns the interpolation (first, second, β) → code.

    Args:
      agent: the agent whose codes are interpolated.
      along: `chord`, the paper's normalised sum, or `arc`, the great circle.

    Raises:
      UsageError: `arc` for codes that do not lie on a sphere.
    """
    if along == "chord":
        return partial(blend, project=agent.project)
    if not agent.on_sphere:
        raise UsageError("--along arc needs LTEs on a sphere, which this run does not have; use --along chord")
    return slerp


def blend_codes(
    agent: Agent, first: ArrayLike, second: ArrayLike, betas: Sequence[float], along: str = "chord"
) -> jax.Array:
    """Returns the codes [betas, code] between two codes [code]; other arguments and errors as in `between`."""
    interpolated, ends = between(agent, along), (jnp.asarray(first), jnp.asarray(second))
    return jnp.stack([interpolated(*ends, jnp.float32(beta)) for beta in betas])


def play_blends(
    trained: Trained, pairs: Sequence[Pair], betas: Sequence[float], episodes: int, seed: int, along: str = "chord"
) -> np.ndarray:
    """Plays every blend of every pair and returns what each achieves in the commanded quantity, [seeds, pairs, betas].

    Args:
      trained: the run.
      pairs: the ends of each interpolation.
      betas: β of equation 1; values outside [0, 1] extrapolate.
      episodes: episodes per blend; the achievement is computed from their mean outcomes.
      seed: seeds the starts.
      along: `chord` or `arc`, as in `between`.

    Raises:
      UsageError: no pairs, or `arc` for codes that do not lie on a sphere.
      RunError: the episodes do not fit in memory.
    """
    seeds = trained.program.config.seeds
    return _play(trained, pairs, np.broadcast_to(betas, (seeds, len(pairs), len(betas))), episodes, seed, along)


def play_again(trained: Trained, pairs: Sequence[Pair], betas: np.ndarray, seed: int, along: str) -> np.ndarray:
    """Plays one blend a seed and pair, β [seeds, pairs], in fresh episodes; returns what each achieves, of that shape.

    The best of many blends on a few episodes is partly the best of their noise; this is without.
    """
    return _play(trained, pairs, betas[..., None], FRESH, seed + AGAIN, along)[..., 0]


def _play(
    trained: Trained, pairs: Sequence[Pair], betas: np.ndarray, episodes: int, seed: int, along: str
) -> np.ndarray:
    """Plays blends β [seeds, pairs, betas]; returns what each achieves, of that shape."""
    if not pairs:
        raise UsageError(f"{trained.name} has no two tasks with a target {trained.program.family.commanded}")
    program, agent = trained.program, trained.program.agent
    check_rollouts(program, betas.size * episodes, program.family.episode_length)
    firsts, seconds = (jnp.stack([end.codes for end in ends], axis=1) for ends in zip(*pairs, strict=True))
    over_betas = jax.vmap(between(agent, along), in_axes=(None, None, 0))

    def of_seed(policy: Params, key: jax.Array, first: jax.Array, second: jax.Array, betas: jax.Array) -> jax.Array:
        codes = jax.vmap(over_betas)(first, second, betas)
        played = play_codes(program, policy, codes.reshape(-1, agent.code_size), key, episodes)
        return achieved(program.family, played)

    given = jnp.asarray(betas, jnp.float32)
    return for_each_seed(trained, of_seed, seed, firsts, seconds, given).reshape(betas.shape)


def interpolate(
    trained: Trained, pairs: Sequence[Pair], target: float | None, episodes: int, seed: int, along: str = "chord"
) -> dict[str, Any]:
    """Finds for every seed and pair the β that comes nearest to the target, and the paper's two measures of success.

    The β found is played again in `FRESH` episodes from other starts: `fresh` says whether it meets the target there.

    Args:
      trained: the run.
      pairs: the ends of each interpolation, all with targets.
      target: the value to meet between the ends of the only pair; None: midway between the ends of each pair.
      episodes, seed, along: as in `play_blends`.

    Returns:
      The document that `ear interpolate --json` prints.

    Raises:
      UsageError: as `play_blends`, or a target that no blend comes near.
    """
    reached = play_blends(trained, pairs, BETAS, episodes, seed, along)
    family = trained.program.family
    if target is not None:
        _check_reach(family, pairs[0], reached, target)
    found = [[_nearest(family, pair, row, target) for pair, row in zip(pairs, rows, strict=True)] for rows in reached]
    again = play_again(trained, pairs, np.array(BETAS)[found], seed, along)
    scored = [
        {"seed": trained.program.config.seed + index, **_score_pair(family, pair, row, target, fresh)}
        for index, (rows, of_pairs) in enumerate(zip(reached, again, strict=True))
        for pair, row, fresh in zip(pairs, rows, of_pairs, strict=True)
    ]

    def count(measure: str) -> dict[str, int]:
        return {"success": sum(pair[measure] for pair in scored), "total": len(scored)}

    counts = {measure: count(measure) for measure in ("mid_task", "fresh", "one_to_one")}
    return {"pairs": scored, **counts, "betas": BETAS, "commanded": family.quantity}


def _check_reach(family: Family, pair: Pair, reached: np.ndarray, target: float) -> None:
    """Raises UsageError for a target further from every blend than the two ends are from each other."""
    gap = abs(family.difference(pair[0].target, pair[1].target))
    if np.abs(family.difference(reached, target)).min() > gap:
        span = f"{reached.min():.2f} to {reached.max():.2f} {family.unit}"
        raise UsageError(f"no blend of {pair[0].name} and {pair[1].name} comes near {target:g}; they reach {span}")


def _aim(family: Family, pair: Pair, target: float | None) -> tuple[float, float]:
    """Returns the value to meet, by default that midway, and the distance between the two tasks, with its sign."""
    gap = family.difference(pair[1].target, pair[0].target)
    return (pair[0].target or 0.0) + gap / 2 if target is None else target, gap


def _nearest(family: Family, pair: Pair, reached: np.ndarray, target: float | None) -> int:
    """Returns the index in `BETAS` of the blend that comes nearest to the value to meet."""
    return int(np.argmin(np.abs(family.difference(reached, _aim(family, pair, target)[0]))))


def _score_pair(family: Family, pair: Pair, reached: np.ndarray, target: float | None, fresh: float) -> dict[str, Any]:
    """Scores one pair by what its blends achieve at `BETAS`, `reached` [betas], and the one found in fresh episodes."""
    betas, (first, second) = np.array(BETAS), pair
    best, (aim, gap) = _nearest(family, pair, reached, target), _aim(family, pair, target)
    middle, _ = _aim(family, pair, None)
    inside = (betas > MID_TASK_RANGE[0]) & (betas < MID_TASK_RANGE[1])
    halfway = reached[BETAS.index(0.5)]
    share = family.difference(halfway, first.target) / gap  # 0 at the first task, 1 at the second
    return {
        "between": [first.name, second.name],
        "target": aim,
        "beta": BETAS[best],
        "outcome": float(reached[best]),
        "fresh_outcome": float(fresh),
        "fresh": bool(abs(family.difference(fresh, aim)) <= REACHED * abs(gap)),
        "mid_task": bool((np.abs(family.difference(reached, middle))[inside] <= REACHED * abs(gap)).any()),
        "one_to_one": bool(0 < share < 1),
        "one_to_one_outcome": float(halfway),
        "curve": [round(float(value), 4) for value in reached],
    }
