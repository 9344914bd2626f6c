"""Replay: a ring of transitions per task, with outcomes instead of rewards, so that any task can score them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from ear_jax.agents.networks import Standardiser
from ear_jax.envs.batched_env import Transition
from ear_jax.envs.symmetry import Symmetry

SAMPLE = 8192  # slots of each ring used to standardise observations
MIN_VARIANCE = 1e-4  # added to variances, so that constant observations are not divided by 0


@struct.dataclass
class Experience:
    """The stored part of a transition."""

    obs: jax.Array  # [obs]
    action: jax.Array  # [act]
    next_obs: jax.Array  # [obs]
    outcome: Any  # scalars by name
    terminated: jax.Array  # bool


@struct.dataclass
class Replay:
    """Rings of transitions and the total number added to each."""

    rings: Experience  # each leaf [tasks, capacity, …]
    added: jax.Array  # int32 [tasks]
    largest: jax.Array | None = None  # [tasks]: largest mean reward so far, if rewards are scaled by it

    @property
    def size(self) -> jax.Array:
        """The number of transitions each ring holds, int32 [tasks]."""
        return jnp.minimum(self.added, self.rings.terminated.shape[1])


def init(like: Experience, tasks: int, capacity: int, scaled: bool = False) -> Replay:
    """Returns empty rings of `capacity` items each; `like` is one item, `scaled` keeps the largest mean reward."""
    rings = jax.tree.map(lambda leaf: jnp.zeros((tasks, capacity, *leaf.shape), leaf.dtype), like)
    return Replay(rings, jnp.zeros(tasks, jnp.int32), jnp.zeros(tasks) if scaled else None)


def add(replay: Replay, transitions: Transition) -> Replay:
    """Adds transitions [steps, tasks, envs] to their tasks' rings in order of time, without the invalid ones.

    The oldest are overwritten. At most `capacity` transitions per task may be added at once.
    """
    experience = Experience(
        transitions.obs, transitions.action, transitions.next_obs, transitions.outcome, transitions.terminated
    )

    def by_task(leaf: jax.Array) -> jax.Array:
        return jnp.swapaxes(leaf, 0, 1).reshape(leaf.shape[1], -1, *leaf.shape[3:])

    return jax.vmap(_add_to_ring)(replay, jax.tree.map(by_task, experience), by_task(transitions.valid))


def _add_to_ring(replay: Replay, items: Experience, valid: jax.Array) -> Replay:
    """Adds items [n] to one task's ring."""
    capacity = replay.rings.terminated.shape[0]
    slot = (replay.added + jnp.cumsum(valid) - 1) % capacity
    slot = jnp.where(valid, slot, capacity)  # writes past the end are dropped
    rings = jax.tree.map(lambda ring, item: ring.at[slot].set(item, mode="drop"), replay.rings, items)
    return replace(replay, rings=rings, added=replay.added + jnp.sum(valid, dtype=jnp.int32))


def gather(replay: Replay, source: jax.Array, slot: jax.Array) -> Experience:
    """Returns the items [n] in the given slots of the given tasks' rings; `source` and `slot` are int32 [n]."""
    return jax.tree.map(lambda ring: ring[source, slot], replay.rings)


def apply_symmetry(symmetry: Symmetry, variant: jax.Array, item: Experience) -> Experience:
    """Rotates or mirrors one item."""
    obs, next_obs = symmetry.obs(variant, item.obs), symmetry.obs(variant, item.next_obs)
    action, outcome = symmetry.action(variant, item.action), symmetry.outcome(variant, item.outcome)
    return Experience(obs, action, next_obs, outcome, item.terminated)


def recent(replay: Replay, tasks: jax.Array, place: jax.Array, window: int) -> tuple[Experience, jax.Array]:
    """Returns items among the newest `window` of tasks' rings.

    Args:
      replay: the rings.
      tasks: int32 [tasks], whose rings.
      place: [tasks, n] in [0, 1), positions among them, from the newest at 0.
      window: the number of newest items.

    Returns:
      Items [tasks, n], and a bool [tasks, n], False if the ring is empty.
    """
    held = jnp.minimum(replay.size[tasks], window)[:, None]
    age = 1 + jnp.minimum((place * held).astype(jnp.int32), jnp.maximum(held - 1, 0))
    slot = (replay.added[tasks, None] - age) % replay.rings.terminated.shape[1]
    source = jnp.broadcast_to(tasks[:, None], place.shape)
    return gather(replay, source, slot), jnp.broadcast_to(held > 0, place.shape)


def standardiser(replay: Replay) -> Standardiser:
    """Returns the mean and scale of the observations in replay, which must not be empty.

    Large rings are subsampled: using all of a million would cost 5 % of an epoch of the `fast` preset.
    """
    stride = max(1, replay.rings.obs.shape[1] // SAMPLE)
    obs = replay.rings.obs[:, ::stride]
    held = (stride * jnp.arange(obs.shape[1]) < replay.size[:, None])[..., None]  # [tasks, slots, 1]
    count = jnp.sum(held)
    mean = jnp.sum(jnp.where(held, obs, 0.0), (0, 1)) / count
    variance = jnp.sum(jnp.where(held, (obs - mean) ** 2, 0.0), (0, 1)) / count
    return Standardiser(mean, jax.lax.rsqrt(variance + MIN_VARIANCE))
