"""Estimates between surveyed codes: means of what was measured around a code, weighted by a Gaussian of the angle."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

BANDWIDTHS = (0.03, 0.05, 0.08, 0.12, 0.2, 0.3)  # radians


def smooth(surveyed: np.ndarray, values: np.ndarray, codes: np.ndarray, bandwidth: float) -> np.ndarray:
    """Estimates for codes [codes, code] the means [codes, k] of values [places, k] at surveyed codes [places, code]."""
    parts = np.array_split(codes, max(1, len(codes) // 1000))
    return np.concatenate([_weights(part, surveyed, bandwidth) @ values for part in parts])


def best_bandwidth(surveyed: np.ndarray, differences: np.ndarray) -> float:
    """Returns the width, in radians, that predicts each surveyed code best from the others.

    Args:
      surveyed: the codes that were played [places, code].
      differences: of a quantity, [i, j] that of place j minus that of place i.
    """

    errors = [np.mean(np.sum(weights * differences, axis=1) ** 2) for weights in _of_the_others(surveyed)]
    return BANDWIDTHS[int(np.argmin(errors))]


def smooth_best(surveyed: np.ndarray, values: np.ndarray, codes: np.ndarray) -> np.ndarray:
    """Estimates as `smooth` does, each column of values [places, k] with the width that predicts its places best."""
    errors = [((weights @ values - values) ** 2).mean(axis=0) for weights in _of_the_others(surveyed)]
    best = np.argmin(errors, axis=0)
    estimates = np.empty((len(codes), values.shape[1]))
    for row in np.unique(best):
        estimates[:, best == row] = smooth(surveyed, values[:, best == row], codes, BANDWIDTHS[row])
    return estimates


def _of_the_others(surveyed: np.ndarray) -> Iterator[np.ndarray]:
    """Yields for each bandwidth the weights by which surveyed codes are estimated from each other."""
    return (_weights(surveyed, surveyed, bandwidth, leave_out=True) for bandwidth in BANDWIDTHS)


def _weights(codes: np.ndarray, surveyed: np.ndarray, bandwidth: float, leave_out: bool = False) -> np.ndarray:
    """Returns the weights of surveyed codes in the estimates for other codes, [codes, places]; rows sum to one.

    Args:
      codes: the codes to estimate for [codes, code].
      surveyed: the codes that were played [places, code].
      bandwidth: of the Gaussian, in radians.
      leave_out: gives each code no weight in its own estimate; both sets are then the same.
    """
    angle = np.arccos(np.clip(codes @ surveyed.T, -1, 1))
    nearness = -0.5 * (angle / bandwidth) ** 2
    if leave_out:
        np.fill_diagonal(nearness, -np.inf)
    weights = np.exp(nearness - nearness.max(axis=1, keepdims=True))
    return weights / weights.sum(axis=1, keepdims=True)
