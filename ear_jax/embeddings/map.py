"""Maps of the LTE sphere: what the robot achieves all over it, and from a map the best LTE for any target."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ear_jax.agents.networks import Params
from ear_jax.embeddings.codes import spread_codes
from ear_jax.embeddings.evaluate import play_codes
from ear_jax.embeddings.smooth import best_bandwidth, smooth
from ear_jax.embeddings.space import measure_space
from ear_jax.envs import Family
from ear_jax.envs.family import Outcome
from ear_jax.errors import UsageError
from ear_jax.learning.episodes import achieved
from ear_jax.runs.rollouts import check_rollouts
from ear_jax.runs.trained import Trained, for_each_seed
from ear_jax.tasks import TaskSet

PLACES = 500  # codes played if only targets have to be answered
FINE = 20_000  # codes that an answer is chosen from, 0.025 radians apart
MARGIN = 0.05  # distance of a target from the nearest achievement, as a share of the range of achievements


@dataclass(frozen=True)
class LteMap:
    """The achievements of one policy under codes spread over the sphere."""

    codes: np.ndarray  # [places, code]
    achieved: np.ndarray  # [places], in the commanded quantity
    late: dict[str, np.ndarray]  # outcomes over the second half of the episodes, each [places]
    lengths: np.ndarray  # mean length of the episodes, steps [places]


def play_maps(trained: Trained, places: int, episodes: int, seed: int, radius: float | None = None) -> list[LteMap]:
    """Plays every seed's policy under codes spread evenly over the sphere.

    Args:
      trained: the run.
      places: number of codes.
      episodes: episodes per code.
      seed: seeds the starts.
      radius: of the sphere, for an agent whose LTEs lie on none; the maps name their directions.

    Raises:
      UsageError: the agent has no LTEs, or they do not lie on a sphere and no radius is given.
      RunError: the episodes do not fit in memory.
    """
    if radius is None:
        check_sphere(trained)
    program = trained.program
    check_rollouts(program, program.config.seeds * places * episodes, program.family.episode_length)
    codes = spread_codes(places, program.agent.code_size)

    def of_seed(policy: Params, key: jax.Array) -> tuple[jax.Array, Outcome, jax.Array]:
        played = play_codes(program, policy, (radius or 1.0) * jnp.asarray(codes), key, episodes)
        late = jax.tree.map(lambda leaf: leaf.mean(axis=-1), played.late)
        return achieved(program.family, played), late, played.lengths.mean(axis=-1)

    reached, late, lengths = for_each_seed(trained, of_seed, seed)
    return [
        LteMap(codes, reached[index], {name: value[index] for name, value in late.items()}, lengths[index])
        for index in range(program.config.seeds)
    ]


def check_sphere(trained: Trained, size: int | None = None) -> None:
    """Raises UsageError unless a run's codes are LTEs on a sphere, and have `size` numbers if that is given."""
    config, agent = trained.program.config, trained.program.agent
    if agent.embed is None or not agent.on_sphere:
        raise UsageError(f"agent {config.agent} of preset {config.preset} has no sphere of LTEs to map")
    if size not in (None, agent.code_size):
        raise UsageError(f"this run's LTEs have {agent.code_size} numbers; only those with {size} can be drawn")


def describe(trained: Trained, maps: list[LteMap]) -> dict[str, Any]:
    """Returns the document that `ear map --json` prints: per seed the codes played, their achievements and outcomes,
    the LTEs of the training tasks, and measures of the space (`measure_space`)."""
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
                "trained": training_ltes(program.tasks, table[index]),
                "space": space_of(lte_map, family, program.tasks, table[index]),
            }
            for index, lte_map in enumerate(maps)
        ],
    }


def space_of(lte_map: LteMap, family: Family, tasks: TaskSet, codes: np.ndarray) -> dict[str, float] | None:
    """Measures the space of a map, with the training tasks' codes [tasks, code], as `measure_space` does."""
    directions = codes / np.linalg.norm(codes, axis=1, keepdims=True)
    return measure_space(family, lte_map.codes, lte_map.achieved, lte_map.lengths, directions, tasks.targets)


def training_ltes(tasks: TaskSet, codes: np.ndarray) -> list[dict[str, Any]]:
    """Lists training tasks with their LTEs [tasks, code], as documents hold them."""
    return [
        {"name": task.name, "target": task.target, "lte": code.tolist()}
        for task, code in zip(tasks.tasks, codes, strict=True)
    ]


def codes_for_targets(lte_map: LteMap, family: Family, targets: Sequence[float]) -> list[tuple[np.ndarray, float]]:
    """Chooses for each target the code [code] expected to come nearest to it; also returns its predicted achievement.

    The achievement of a code is estimated from the surveyed codes around it, weighted by a Gaussian of their angle to
    it. The code with the least expected squared error is chosen. That error includes the spread among its neighbours,
    so that a code in a uniform region is preferred.
    """
    misses = np.stack([family.difference(lte_map.achieved, target) for target in targets], axis=1)  # [places, targets]
    candidates = spread_codes(FINE, lte_map.codes.shape[1])
    expected = estimate(lte_map, family, candidates, np.concatenate([misses**2, misses], axis=1))
    squared, signed = np.split(expected, 2, axis=1)  # each [candidates, targets]
    return [(candidates[row], float(targets[i] + signed[row, i])) for i, row in enumerate(squared.argmin(axis=0))]


def estimate(lte_map: LteMap, family: Family, codes: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Estimates for any codes [codes, code] the means [codes, k] of values [places, k] of the surveyed codes around."""
    differences = family.difference(lte_map.achieved[None, :], lte_map.achieved[:, None])  # [places, places]
    return smooth(lte_map.codes, values, codes, best_bandwidth(lte_map.codes, differences))


def reaches(lte_map: LteMap, family: Family, target: float) -> bool:
    """True if some surveyed code comes within `MARGIN` of the target, as a share of the range of achievements."""
    nearest = float(np.abs(family.difference(lte_map.achieved, target)).min())
    return nearest <= MARGIN * float(np.ptp(lte_map.achieved))


def check_reach(maps: list[LteMap], family: Family, target: float) -> None:
    """Raises UsageError, with the range of achievements, for a target that one of the policies does not reach."""
    for lte_map in maps:
        if not reaches(lte_map, family, target):
            low, high = float(lte_map.achieved.min()), float(lte_map.achieved.max())
            raise UsageError(
                f"no LTE of this run comes near {target:g} {family.unit}; they reach {low:.2f} to {high:.2f}"
            )
