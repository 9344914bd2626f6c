"""Advantages: returns of steps relative to what was expected, by a baseline fitted to the same episodes or a value."""

from __future__ import annotations

import jax
import jax.numpy as jnp

RIDGE = 1e-4  # for features of mean square 1
MAX_OBS = 10.0  # observations are clipped to ± this, as in rll/rllab


def returns_to_go(reward: jax.Array, valid: jax.Array, discount: float) -> jax.Array:
    """Returns the discounted sums of rewards from each step on, [steps, …]; invalid steps count as 0."""

    def accumulate(later: jax.Array, reward: jax.Array) -> tuple[jax.Array, jax.Array]:
        total = reward + discount * later
        return total, total

    rewards = jnp.where(valid, reward, 0.0)
    return jax.lax.scan(accumulate, jnp.zeros(reward.shape[1:]), rewards, reverse=True)[1]


def advantages(obs: jax.Array, reward: jax.Array, valid: jax.Array, discount: float, gae_lambda: float) -> jax.Array:
    """Returns generalised advantages (Schulman et al. 2015, arXiv 1506.02438), standardised over the valid steps.

    Their baseline is that of Duan et al. (2016, arXiv 1604.06778), fitted to the returns of the same episodes by least
    squares on 1, s, s², t, t², t³, with t in hundreds of steps. Episodes are complete: nothing follows their end.

    Args:
      obs: [steps, episodes, obs].
      reward: [steps, episodes].
      valid: bool [steps, episodes], False after an episode's end.
      discount: γ.
      gae_lambda: λ. With 1 an advantage is the return from a step on less the baseline. A smaller λ trusts the
        baseline of later steps instead of their rewards, which is less noisy and biased where the baseline is wrong.

    Returns:
      Advantages [steps, episodes], 0 where not valid.
    """
    to_go, count = returns_to_go(reward, valid, discount), jnp.maximum(jnp.sum(valid), 1)
    time = jnp.broadcast_to(jnp.arange(len(obs))[:, None, None] / 100, (*reward.shape, 1))
    clipped = jnp.clip(obs, -MAX_OBS, MAX_OBS)
    features = jnp.concatenate([jnp.ones_like(time), clipped, clipped**2, time, time**2, time**3], axis=-1)
    features = jnp.where(valid[..., None], features, 0.0)
    features /= jnp.sqrt(jnp.sum(features**2, axis=(0, 1)) / count + 1e-8)
    gram = jnp.einsum("sef,seg->fg", features, features) / count + RIDGE * jnp.eye(features.shape[-1])
    weights = jax.scipy.linalg.solve(gram, jnp.einsum("sef,se->f", features, to_go) / count, assume_a="pos")
    baseline = features @ weights  # 0 where not valid
    return standardised(generalised_advantages(reward, baseline, valid, discount, gae_lambda), valid)


def generalised_advantages(
    reward: jax.Array, value: jax.Array, valid: jax.Array, discount: float, gae_lambda: float
) -> jax.Array:
    """Returns generalised advantages [steps, …] of complete episodes, 0 where not valid.

    Args:
      reward: [steps, …].
      value: as `reward`, the return that is expected from each step on; 0 where not valid.
      valid: bool, as `reward`, False after an episode's end.
      discount: γ.
      gae_lambda: λ.
    """
    surprise = reward + discount * jnp.concatenate([value[1:], jnp.zeros_like(value[:1])]) - value
    return jnp.where(valid, returns_to_go(surprise, valid, discount * gae_lambda), 0.0)


def mean_valid(values: jax.Array, valid: jax.Array) -> jax.Array:
    """Averages values where they are valid; 0 if none is."""
    return jnp.sum(jnp.where(valid, values, 0.0)) / jnp.maximum(jnp.sum(valid), 1)


def standardised(advantage: jax.Array, valid: jax.Array) -> jax.Array:
    """Standardises valid advantages; those that are not valid are 0, before and after."""
    count = jnp.maximum(jnp.sum(valid), 1)
    centred = jnp.where(valid, advantage - jnp.sum(advantage) / count, 0.0)
    return centred / (jnp.sqrt(jnp.sum(centred**2) / count) + 1e-8)
