"""A map of the sphere of codes: what each place makes the robot do, and so which to take for any target."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ear_jax.agents.networks import Params
from ear_jax.embeddings.codes import spread_codes
from ear_jax.embeddings.evaluate import play_codes
from ear_jax.envs import Family
from ear_jax.envs.family import Outcome
from ear_jax.errors import UsageError
from ear_jax.learning.episodes import achieved
from ear_jax.runs.trained import Trained, for_each_seed

PLACES = 500  # codes played when only an answer is wanted
FINE = 20_000  # codes the answer is chosen from, 0.025 radians apart
MARGIN = 0.05  # of the range that was reached: how far beyond it a target may lie
BANDWIDTHS = (0.03, 0.05, 0.08, 0.12, 0.2, 0.3)  # radians


@dataclass(frozen=True)
class LteMap:
    """What one policy does under codes spread over the sphere."""

    codes: np.ndarray  # [places, code]
    achieved: np.ndarray  # [places], in the commanded quantity
    late: dict[str, np.ndarray]  # outcomes over the second half of the episodes, each [places]


def survey(trained: Trained, places: int, episodes: int, seed: int) -> list[LteMap]:
    """Plays every seed's policy under codes spread evenly over the sphere.

    Args:
      trained: the run.
      places: how many codes.
      episodes: how many a code.
      seed: of the starts.

    Raises:
      UsageError: an agent without LTEs, or whose LTEs do not lie on a sphere.
    """
    check_sphere(trained)
    program = trained.program
    codes = spread_codes(places, program.agent.code_size)

    def of_seed(policy: Params, key: jax.Array) -> tuple[jax.Array, Outcome]:
        played = play_codes(program, policy, jnp.asarray(codes), key, episodes)
        return achieved(program.family, played), jax.tree.map(lambda leaf: leaf.mean(axis=-1), played.late)

    reached, late = for_each_seed(trained, of_seed, seed)
    return [
        LteMap(codes, reached[index], {name: value[index] for name, value in late.items()})
        for index in range(program.config.seeds)
    ]


def check_sphere(trained: Trained, size: int | None = None) -> None:
    """Raises UsageError unless a run's codes are LTEs that lie on a sphere, in `size` dimensions where that matters."""
    config, agent = trained.program.config, trained.program.agent
    if agent.embed is None or not agent.on_sphere:
        raise UsageError(f"agent {config.agent} of preset {config.preset} has no sphere of LTEs to map")
    if size not in (None, agent.code_size):
        raise UsageError(f"this run's codes have {agent.code_size} numbers; only a sphere of {size} can be drawn")


def describe(trained: Trained, maps: list[LteMap]) -> dict[str, Any]:
    """What `ear map --json` prints: per seed every place, what was achieved there, and where the training tasks are."""
    program, family = trained.program, trained.program.family
    table = np.asarray(jax.vmap(program.agent.codes)(trained.policies))
    return {
        "commanded": {**family.quantity, "period": family.period},
        "seeds": [
            {
                "seed": program.config.seed + index,
                "ltes": np.round(lte_map.codes, 5).tolist(),
                "achieved": np.round(lte_map.achieved, 4).tolist(),
                "outcomes": {name: np.round(value, 4).tolist() for name, value in lte_map.late.items()},
                "trained": [
                    {"name": task.name, "target": task.target, "lte": code.tolist()}
                    for task, code in zip(program.tasks.tasks, table[index], strict=True)
                ],
            }
            for index, lte_map in enumerate(maps)
        ],
    }


def code_for_target(lte_map: LteMap, family: Family, target: float) -> tuple[np.ndarray, float]:
    """The code [code] expected to come nearest to a target, and what it is predicted to achieve.

    What a code does is estimated from the surveyed places around it, weighted by a Gaussian of their angle from it. The
    code chosen is the one whose expected squared miss is least, bias and spread together: among codes that promise the
    target, one amid others that keep the promise.
    """
    miss = family.difference(lte_map.achieved, target)  # [places]
    candidates = spread_codes(FINE, lte_map.codes.shape[1])
    bandwidth = _bandwidth(lte_map, family)
    expected = np.concatenate(
        [
            _weights(part, lte_map.codes, bandwidth) @ np.stack([miss**2, miss], 1)
            for part in np.array_split(candidates, 20)
        ]
    )
    best = int(np.argmin(expected[:, 0]))
    return candidates[best], float(target + expected[best, 1])


def _bandwidth(lte_map: LteMap, family: Family) -> float:
    """The width, in radians, by which each place is best foretold from the others."""
    apart = family.difference(lte_map.achieved[None, :], lte_map.achieved[:, None])  # [places, places]

    def error(bandwidth: float) -> float:
        weights = _weights(lte_map.codes, lte_map.codes, bandwidth, leave_out=True)
        return float(np.mean(np.sum(weights * apart, axis=1) ** 2))

    return min(BANDWIDTHS, key=error)


def _weights(codes: np.ndarray, places: np.ndarray, bandwidth: float, leave_out: bool = False) -> np.ndarray:
    """How much each place tells of each code, [codes, places], rows summing to one; `leave_out`: nothing of itself."""
    angle = np.arccos(np.clip(codes @ places.T, -1, 1))
    nearness = -0.5 * (angle / bandwidth) ** 2
    if leave_out:
        np.fill_diagonal(nearness, -np.inf)
    weights = np.exp(nearness - nearness.max(axis=1, keepdims=True))
    return weights / weights.sum(axis=1, keepdims=True)


def reaches(lte_map: LteMap, family: Family, target: float) -> bool:
    """Whether a target lies no further from some surveyed code than a small part of the range that they reach."""
    nearest = float(np.abs(family.difference(lte_map.achieved, target)).min())
    return nearest <= MARGIN * float(np.ptp(lte_map.achieved))


def check_reach(maps: list[LteMap], family: Family, target: float) -> None:
    """Refuses a target that one of the policies does not reach.

    Raises:
      UsageError: with the range that was reached.
    """
    for lte_map in maps:
        if not reaches(lte_map, family, target):
            low, high = float(lte_map.achieved.min()), float(lte_map.achieved.max())
            raise UsageError(
                f"no code of this run comes near {target:g} {family.unit}; they reach {low:.2f} to {high:.2f}"
            )
