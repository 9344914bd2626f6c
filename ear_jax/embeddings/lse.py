"""The latent sensory embedding (LSE) along a gait, compared with the raw observations that it encodes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ear_jax.agents.networks import Params
from ear_jax.envs.batched_env import BatchedEnv, Transition
from ear_jax.errors import UsageError
from ear_jax.learning.rollout import act_with, first_episode, rollout
from ear_jax.runs.trained import Trained, for_each_seed

SETTLED = 50  # steps left out at the start, while the robot gets going
NEARLY = 0.8  # share of the highest peak of an autocorrelation that its period has at least


@dataclass(frozen=True)
class Signal:
    """The principal components and periodicity of a signal [steps, channels]."""

    path: np.ndarray  # [steps, 2], the first two principal components
    explained: np.ndarray  # [2], their shares of the variance
    autocorrelation: np.ndarray  # [lags], 1 at lag 0
    period: int  # steps; 0 if there is none
    peak: float  # the autocorrelation there


def lse(trained: Trained, task: str, seed: int) -> dict[str, Any]:
    """Analyses one episode of a training task under every seed's policy.

    Args:
      trained: the run.
      task: the task's name.
      seed: seeds the start.

    Returns:
      The document that `ear lse --json` prints; periods in seconds.

    Raises:
      UsageError: no such task, an agent without an LSE, or an episode too short for a gait.
    """
    dt = trained.program.family.dt
    seeds = [
        {"seed": trained.program.config.seed + index, **{name: _describe(signal, dt) for name, signal in both.items()}}
        for index, both in enumerate(record_signals(trained, task, seed))
    ]
    return {"task": task, "dt": round(dt, 6), "seeds": seeds}


def record_signals(trained: Trained, task: str, seed: int) -> list[dict[str, Signal]]:
    """Returns for every seed's policy the signals `state` and `lse`; arguments and errors as in `lse`."""
    program, agent = trained.program, trained.program.agent
    if agent.embed is None:
        raise UsageError(f"agent {program.config.agent} has no latent sensory embedding")
    embed, row = agent.embed, program.tasks.index(task)
    env, steps = BatchedEnv(program.family, resets=False), program.family.episode_length
    params = jax.tree.map(lambda leaf: leaf[row : row + 1], program.tasks.params)

    def record(transition: Transition) -> tuple[jax.Array, jax.Array]:
        return transition.obs[0, 0], transition.failed[0, 0]

    def of_seed(policy: Params, key: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        act = act_with(agent, policy, agent.codes(policy)[row : row + 1])
        noise = jnp.zeros((steps, 1, 1, program.family.action_size))
        _, (obs, over) = rollout(env, act, env.start(key, params, 1), noise, record)
        newest = obs[:, -(program.family.observation_size // program.family.history) :]
        return newest, jax.vmap(lambda obs: embed(policy, obs))(obs), over

    states, embeddings, overs = for_each_seed(trained, of_seed, seed)
    lengths = [int(first_episode(over).sum()) for over in overs]
    if min(lengths) < 2 * SETTLED:
        raise UsageError(
            f"{task} ends after {min(lengths)} steps, and a gait takes {2 * SETTLED}; name another task with --task"
        )
    return [
        {"state": analyse(state[SETTLED:length]), "lse": analyse(embedding[SETTLED:length])}
        for state, embedding, length in zip(states, embeddings, lengths, strict=True)
    ]


def analyse(signal: np.ndarray) -> Signal:
    """Computes the principal components and the autocorrelation of a signal [steps, channels]."""
    path, explained = principal_components(signal)
    correlation = autocorrelation(signal)
    period = first_peak(correlation)
    return Signal(path, explained, correlation, period, float(correlation[period]) if period else 0.0)


def principal_components(signal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns a signal [steps, channels] in its first two principal components [steps, 2], and their shares of the
    variance [2], by SVD."""
    left, sizes, _ = np.linalg.svd(signal - signal.mean(0), full_matrices=False)
    return left[:, :2] * sizes[:2], sizes[:2] ** 2 / max(float(np.sum(sizes**2)), 1e-12)


def autocorrelation(signal: np.ndarray) -> np.ndarray:
    """Returns the autocorrelation of a signal [steps, channels], summed over channels, at lags up to half its length.

    Each lag takes the mean product over the steps that overlap, so that a perfect repetition gives 1 at any lag.
    """
    centred = signal - signal.mean(0)
    power = max(float(np.mean(np.sum(centred**2, 1))), 1e-12)
    steps = len(centred)
    products = (np.mean(np.sum(centred[: steps - lag] * centred[lag:], 1)) for lag in range(steps // 2))
    return np.fromiter(products, float) / power


def first_peak(correlation: np.ndarray) -> int:
    """Returns the lag of the first peak nearly as high as the highest one; 0 if there is none.

    Peaks are local maxima after the first negative value. A signal also repeats after multiples of its period, and
    noise decides which of those peaks is the highest, so the first counts that has a share of at least `NEARLY` of it.
    """
    below = np.flatnonzero(correlation < 0)
    if not len(below):
        return 0
    inner = correlation[1:-1]
    peaks = 1 + np.flatnonzero((inner >= correlation[:-2]) & (inner > correlation[2:]))
    peaks = peaks[peaks > below[0]]
    high = peaks[correlation[peaks] >= NEARLY * max(correlation[peaks], default=0.0)]
    return int(high[0]) if len(high) else 0


def _describe(signal: Signal, dt: float) -> dict[str, Any]:
    return {
        "explained": np.round(signal.explained, 4).tolist(),
        "period": round(signal.period * dt, 4),
        "autocorrelation_peak": round(signal.peak, 4),
        "path": np.round(signal.path, 4).tolist(),
        "autocorrelation": np.round(signal.autocorrelation, 4).tolist(),
    }
