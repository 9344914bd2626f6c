"""Statistics of a few seeds: interquartile mean, bootstrap intervals, probability of improvement. NumPy alone.

The definitions are those of Agarwal et al. 2021, "Deep RL at the edge of the statistical precipice" (rliable). Scores
are [seeds, tasks]. Statistics also take leading axes, so that one call serves all resamples of a bootstrap.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

RESAMPLES = 2000
CONFIDENCE = 0.95


def interquartile_mean(scores: np.ndarray) -> np.ndarray:
    """Returns the mean [...] of the middle half of all scores [..., seeds, tasks], over tasks and seeds.

    Of n scores, floor(n / 4) are left out at either end, as in `scipy.stats.trim_mean(scores, 0.25, axis=None)`.
    """
    scores = np.asarray(scores, float)
    ordered = np.sort(scores.reshape(*scores.shape[:-2], -1))
    cut = ordered.shape[-1] // 4
    return np.asarray(ordered[..., cut : ordered.shape[-1] - cut].mean(-1))


def probability_of_improvement(ours: np.ndarray, theirs: np.ndarray) -> np.ndarray:
    """Returns how often a seed of ours beats a seed of theirs on the same task, averaged over tasks.

    Args:
      ours, theirs: [..., seeds, tasks]; the numbers of seeds may differ.

    Returns:
      [...] in [0, 1], Mann and Whitney's U over the number of pairs; ties count one half.
    """
    apart = np.asarray(ours, float)[..., :, None, :] - np.asarray(theirs, float)[..., None, :, :]
    return np.asarray(np.mean((apart > 0) + 0.5 * (apart == 0), axis=(-3, -2, -1)))


def bootstrap_interval(
    statistic: Callable[..., np.ndarray], *scores: np.ndarray, seed: int = 0, resamples: int = RESAMPLES
) -> tuple[float, float]:
    """Returns the 95 % percentile interval of a statistic under a stratified bootstrap.

    Args:
      statistic: maps arrays [resamples, seeds, tasks], one for each of `scores`, to [resamples].
      *scores: each [seeds, tasks]; seeds are drawn with replacement, separately for each task (the strata).
      seed: seeds the draws.
      resamples: number of draws.
    """
    rng = np.random.default_rng(seed)

    def resample(table: np.ndarray) -> np.ndarray:
        rows = rng.integers(0, len(table), (resamples, *table.shape))
        return np.take_along_axis(np.broadcast_to(table, rows.shape), rows, axis=1)

    values = statistic(*(resample(np.asarray(table, float)) for table in scores))
    tail = (1 - CONFIDENCE) / 2
    low, high = np.quantile(values, (tail, 1 - tail))
    return float(low), float(high)
