"""How much better each step of some episodes turned out than a baseline fitted to them foretold."""

from __future__ import annotations

import jax
import jax.numpy as jnp

RIDGE = 1e-4  # of features whose mean square is 1
SEEN = 10.0  # observations are clipped to ± this, as in rll/rllab


def returns_to_go(reward: jax.Array, valid: jax.Array, discount: float) -> jax.Array:
    """Σ γᵏ r of what is left of an episode, for rewards [steps, …] of which those that are not valid count nothing."""

    def back(later: jax.Array, now: jax.Array) -> tuple[jax.Array, jax.Array]:
        total = now + discount * later
        return total, total

    rewards = jnp.where(valid, reward, 0.0)
    return jax.lax.scan(back, jnp.zeros(reward.shape[1:]), rewards, reverse=True)[1]


def advantages(obs: jax.Array, reward: jax.Array, valid: jax.Array, discount: float) -> jax.Array:
    """What followed each step, less a linear baseline of observation and time, standardised over the valid steps.

    The baseline is that of Duan et al. (2016, arXiv 1604.06778): 1, s, s², t, t², t³, t in hundreds of steps, least
    squares on the same episodes. Without bootstrapping (GAE's λ = 1), as episodes are whole.

    Args:
      obs: [steps, episodes, obs].
      reward: [steps, episodes].
      valid: bool [steps, episodes]: the others are no part of an episode.
      discount: γ.

    Returns:
      [steps, episodes], 0 where not valid.
    """
    to_go, count = returns_to_go(reward, valid, discount), jnp.maximum(jnp.sum(valid), 1)
    time = jnp.broadcast_to(jnp.arange(len(obs))[:, None, None] / 100, (*reward.shape, 1))
    seen = jnp.clip(obs, -SEEN, SEEN)
    features = jnp.concatenate([jnp.ones_like(time), seen, seen**2, time, time**2, time**3], axis=-1)
    features = jnp.where(valid[..., None], features, 0.0)
    features /= jnp.sqrt(jnp.sum(features**2, axis=(0, 1)) / count + 1e-8)
    gram = jnp.einsum("sef,seg->fg", features, features) / count + RIDGE * jnp.eye(features.shape[-1])
    weights = jax.scipy.linalg.solve(gram, jnp.einsum("sef,se->f", features, to_go) / count, assume_a="pos")
    better = jnp.where(valid, to_go - features @ weights, 0.0)
    better = jnp.where(valid, better - jnp.sum(better) / count, 0.0)
    return better / (jnp.sqrt(jnp.sum(better**2) / count) + 1e-8)
