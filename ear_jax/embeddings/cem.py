"""The cross-entropy method over codes (algorithm 2) as pure functions of its state: init, ask, tell."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from flax import struct

from ear_jax.embeddings.codes import Project


@struct.dataclass
class Cem:
    """The state of one search: the elites, best of the last epoch first."""

    elites: jax.Array  # [elites, code]


def init(key: jax.Array, elites: int, code_size: int, project: Project) -> Cem:
    """Draws elites N(0, 1) and projects them, which is uniform on a sphere."""
    return Cem(jax.vmap(project)(jax.random.normal(key, (elites, code_size))))


def ask(state: Cem, key: jax.Array, samples: int, sigma: float, project: Project) -> jax.Array:
    """Returns the elites and `samples` neighbours of each, N(0, σ²) away: [elites · (1 + samples), code]."""
    elites, code_size = state.elites.shape
    noise = sigma * jax.random.normal(key, (elites, samples, code_size))
    neighbours = jax.vmap(jax.vmap(project))(state.elites[:, None] + noise)
    return jnp.concatenate([state.elites, neighbours.reshape(-1, code_size)])


def tell(state: Cem, candidates: jax.Array, returns: jax.Array) -> Cem:
    """Keeps the best candidates [n, code] by their returns [n]."""
    _, best = jax.lax.top_k(returns, len(state.elites))
    return Cem(candidates[best])
