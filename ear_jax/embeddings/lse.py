"""What the state encoder makes of a gait: latent state embeddings beside the raw observations they come from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ear_jax.agents.networks import Params
from ear_jax.envs.batched_env import BatchedEnv, Transition
from ear_jax.errors import UsageError
from ear_jax.learning.rollout import act_with, rollout
from ear_jax.runs.trained import Trained, for_each_seed

SETTLED = 50  # steps left out at the start, in which the robot gets going


@dataclass(frozen=True)
class Signal:
    """A signal [steps, channels] along a trajectory: where it goes in its two main directions, and how it repeats."""

    path: np.ndarray  # [steps, 2]
    explained: np.ndarray  # [2], shares of the variance
    autocorrelation: np.ndarray  # [lags], 1 at lag 0
    period: int  # steps to the highest peak, 0 where there is none
    peak: float  # the autocorrelation there


def sense(trained: Trained, task: str, seed: int) -> list[dict[str, Signal]]:
    """For every seed's policy, one episode of a training task as `state` and as `lse`.

    Args:
      trained: the run.
      task: the task's name.
      seed: of the start.

    Raises:
      UsageError: no such task, an agent that embeds no state, or an episode that ends before there is a gait.
    """
    program, agent = trained.program, trained.program.agent
    if agent.embed is None:
        raise UsageError(f"agent {program.config.agent} has no latent state embedding")
    embed, row = agent.embed, program.tasks.index(task)
    grid, steps = BatchedEnv(program.family), program.family.episode_length
    params = jax.tree.map(lambda leaf: leaf[row : row + 1], program.tasks.params)

    def record(transition: Transition) -> tuple[jax.Array, jax.Array]:
        return transition.obs[0, 0], (transition.terminated | ~transition.valid)[0, 0]

    def of_seed(policy: Params, key: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        act = act_with(agent, policy, agent.codes(policy)[row : row + 1])
        noise = jnp.zeros((steps, 1, 1, program.family.action_size))
        _, (obs, over) = rollout(grid, act, grid.start(key, params, 1), noise, record)
        newest = obs[:, -(program.family.observation_size // program.family.history) :]
        return newest, jax.vmap(lambda one: embed(policy, one))(obs), over

    seen = for_each_seed(trained, of_seed, seed)
    lengths = [int(np.argmax(over)) + 1 if over.any() else steps for over in seen[2]]
    if min(lengths) < 2 * SETTLED:
        raise UsageError(f"{task} lasts {min(lengths)} of {steps} steps, too few for a gait; name another with --task")
    gaits = [slice(SETTLED, length) for length in lengths]
    return [
        {"state": analyse(obs[gait]), "lse": analyse(lse[gait])}
        for obs, lse, gait in zip(*seen[:2], gaits, strict=True)
    ]


def analyse(signal: np.ndarray) -> Signal:
    """Principal components and autocorrelation of a signal [steps, channels]."""
    path, explained = principal_components(signal)
    correlation = autocorrelation(signal)
    period = highest_peak(correlation)
    return Signal(path, explained, correlation, period, float(correlation[period]) if period else 0.0)


def principal_components(signal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A signal [steps, channels] in its two main directions [steps, 2], and their shares of the variance, by SVD."""
    left, sizes, _ = np.linalg.svd(signal - signal.mean(0), full_matrices=False)
    return left[:, :2] * sizes[:2], sizes[:2] ** 2 / max(float(np.sum(sizes**2)), 1e-12)


def autocorrelation(signal: np.ndarray) -> np.ndarray:
    """Of a signal [steps, channels], all channels together, at lags up to half its length.

    At each lag the mean product of overlapping steps, so that a perfect repetition gives 1 however late it comes.
    """
    centred = signal - signal.mean(0)
    power = max(float(np.mean(np.sum(centred**2, 1))), 1e-12)
    steps = len(centred)
    products = (np.mean(np.sum(centred[: steps - lag] * centred[lag:], 1)) for lag in range(steps // 2))
    return np.fromiter(products, float) / power


def highest_peak(correlation: np.ndarray) -> int:
    """The lag of the highest local maximum after the first fall below zero; 0 where there is none."""
    below = np.flatnonzero(correlation < 0)
    if not len(below):
        return 0
    inner = correlation[1:-1]
    peaks = 1 + np.flatnonzero((inner >= correlation[:-2]) & (inner > correlation[2:]))
    peaks = peaks[peaks > below[0]]
    return int(peaks[np.argmax(correlation[peaks])]) if len(peaks) else 0


def describe(trained: Trained, task: str, signals: list[dict[str, Signal]]) -> dict[str, Any]:
    """What `ear lse --json` prints; periods in seconds."""
    dt = trained.program.family.dt
    return {
        "task": task,
        "dt": round(dt, 6),
        "seeds": [
            {
                "seed": trained.program.config.seed + index,
                **{
                    name: {
                        "explained": np.round(signal.explained, 4).tolist(),
                        "period": round(signal.period * dt, 4),
                        "autocorrelation_peak": round(signal.peak, 4),
                        "path": np.round(signal.path, 4).tolist(),
                        "autocorrelation": np.round(signal.autocorrelation, 4).tolist(),
                    }
                    for name, signal in both.items()
                },
            }
            for index, both in enumerate(signals)
        ],
    }
