"""What a few seeds tell: interquartile mean, bootstrap intervals, probability of improvement. NumPy alone.

The definitions are those of Agarwal et al. 2021, "Deep RL at the edge of the statistical precipice" (rliable). Scores
are [seeds, tasks]. Every statistic takes leading axes too, so that one call serves all of a bootstrap's resamples.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

RESAMPLES = 2000
CONFIDENCE = 0.95


def interquartile_mean(scores: np.ndarray) -> np.ndarray:
    """The mean of the middle half of all scores [..., seeds, tasks], tasks and seeds together: [...].

    Of n scores floor(n / 4) are left out at either end, as `scipy.stats.trim_mean(scores, 0.25, axis=None)` does.
    """
    scores = np.asarray(scores, float)
    ordered = np.sort(scores.reshape(*scores.shape[:-2], -1))
    cut = ordered.shape[-1] // 4
    return ordered[..., cut : ordered.shape[-1] - cut].mean(-1)


def probability_of_improvement(ours: np.ndarray, theirs: np.ndarray) -> np.ndarray:
    """How often a seed of ours beats one of theirs on the same task, the mean over tasks; ties count one half.

    Args:
      ours, theirs: [..., seeds, tasks]; the numbers of seeds may differ.

    Returns:
      [...], from 0 to 1: Mann and Whitney's U over the number of pairs.
    """
    apart = np.asarray(ours, float)[..., :, None, :] - np.asarray(theirs, float)[..., None, :, :]
    return np.mean((apart > 0) + 0.5 * (apart == 0), axis=(-3, -2, -1))


def bootstrap_interval(
    statistic: Callable[..., np.ndarray], *scores: np.ndarray, seed: int = 0, resamples: int = RESAMPLES
) -> tuple[float, float]:
    """The 95 % percentile interval of a statistic under a stratified bootstrap.

    Args:
      statistic: of as many arrays [resamples, seeds, tasks] as there are scores: [resamples].
      *scores: each [seeds, tasks]; seeds are drawn with replacement, for each task (a stratum) by themselves.
      seed: of the draws.
      resamples: how many.
    """
    rng = np.random.default_rng(seed)

    def resample(table: np.ndarray) -> np.ndarray:
        drawn = rng.integers(0, len(table), (resamples, *table.shape))
        return np.take_along_axis(np.broadcast_to(table, drawn.shape), drawn, axis=1)

    values = statistic(*(resample(np.asarray(table, float)) for table in scores))
    tail = (1 - CONFIDENCE) / 2
    low, high = np.quantile(values, (tail, 1 - tail))
    return float(low), float(high)
