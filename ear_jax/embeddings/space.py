"""Measures of a space of LTEs: smooth, of use everywhere, complete and in order."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ear_jax.envs import Family

NEIGHBOURS = 6  # of a place; about that many surround it on an even sphere
STEEP = 95  # percentile of the slopes that is taken as the typical steep one; one fall more or less moves the maximum
TOLERANCE = 0.01  # how near a value is met, as a share of the commanded range
VALUES = 201  # over the commanded range


def measure_space(
    family: Family,
    codes: np.ndarray,
    achieved: np.ndarray,
    lengths: np.ndarray,
    trained: np.ndarray,
    targets: Sequence[float | None],
) -> dict[str, float] | None:
    """Measures one policy's space from a map of it.

    Args:
      family: the family, whose commanded quantity is measured.
      codes: unit vectors [places, code] that were played.
      achieved: the commanded quantity under each [places].
      lengths: mean length of the episodes under each [places], steps.
      trained: unit vectors of the training tasks [tasks, code].
      targets: of the training tasks; those without one do not count.

    Returns:
      `lipschitz`, the steepest slope between neighbouring places, and `steep`, its 95th percentile, both in the
      commanded unit per radian; `smooth`, the slope of an ideal space, which spreads the commanded range evenly over
      half a great circle, as a share of `steep`, at most 1; `lasting`, the share of places whose episodes last;
      `covered`, the share of the commanded range that lasting places meet; `ordered`, the rank correlation of the
      tasks' distances in target and in angle; and `space`, the geometric mean of the last four. None if fewer than
      three tasks have a target.
    """
    known = np.array([row for row, target in enumerate(targets) if target is not None])
    if len(known) < 3:
        return None
    goals = np.array([targets[row] for row in known], float)
    low, high = (0.0, family.period) if family.period else (float(goals.min()), float(goals.max()))
    slopes = _slopes(family, codes, achieved)
    steep = float(np.percentile(slopes, STEEP))
    lasting = lengths >= family.episode_length
    shares = {
        "smooth": min(1.0, (high - low) / np.pi / max(steep, 1e-9)),
        "lasting": float(lasting.mean()),
        "covered": _covered(family, achieved[lasting], low, high),
        "ordered": _ordered(family, trained[known], goals),
    }
    space = float(np.prod(np.clip(list(shares.values()), 0, 1)) ** (1 / len(shares)))
    numbers = {"space": space, **shares, "lipschitz": float(slopes.max()), "steep": steep}
    return {name: round(value, 4) for name, value in numbers.items()}


def _slopes(family: Family, codes: np.ndarray, achieved: np.ndarray) -> np.ndarray:
    """Returns the change of the commanded quantity per radian from places to their neighbours, [places, neighbours]."""
    angles = _angles(codes, codes)
    np.fill_diagonal(angles, np.inf)
    near = np.argsort(angles, axis=1)[:, :NEIGHBOURS]
    changes = np.abs(family.difference(achieved[near], achieved[:, None]))
    apart = np.take_along_axis(angles, near, axis=1)
    return np.divide(changes, apart, out=np.zeros(changes.shape), where=apart > 0)  # 0 where places coincide


def _covered(family: Family, achieved: np.ndarray, low: float, high: float) -> float:
    """Returns the share of the values from `low` to `high` that some place meets."""
    if not len(achieved):
        return 0.0
    values = np.linspace(low, high, VALUES)
    nearest = np.abs(family.difference(achieved[None, :], values[:, None])).min(axis=1)
    return float((nearest <= TOLERANCE * (high - low)).mean())


def _ordered(family: Family, codes: np.ndarray, goals: np.ndarray) -> float:
    """Returns the rank correlation of distances in target and in angle over all pairs of tasks, 0 if all are equal."""
    one, other = np.triu_indices(len(goals), 1)
    apart = np.abs(family.difference(goals[one], goals[other]))
    ranks = [_ranks(np.round(values, 6)) for values in (apart, _angles(codes, codes)[one, other])]
    return float(np.corrcoef(np.stack(ranks))[0, 1]) if all(map(np.ptp, ranks)) else 0.0


def _ranks(values: np.ndarray) -> np.ndarray:
    """Returns the rank of each value; equal values share the mean of their ranks."""
    _, place, counts = np.unique(values, return_inverse=True, return_counts=True)
    ends = np.cumsum(counts)
    return (ends - (counts - 1) / 2)[place]


def _angles(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    return np.arccos(np.clip(one @ other.T, -1, 1))
