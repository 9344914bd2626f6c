"""One ring of transitions per task, holding outcomes rather than rewards, so that any task can score any of them."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from ear_jax.agents.networks import Standardiser
from ear_jax.envs.batched_env import Transition
from ear_jax.envs.symmetry import Symmetry

SAMPLE = 8192  # slots of a ring by which observations are standardised
MIN_VARIANCE = 1e-4  # of an observation; one that never changes is not blown up


@struct.dataclass
class Experience:
    """What is learnt from a transition."""

    obs: jax.Array
    action: jax.Array
    next_obs: jax.Array
    outcome: Any
    terminated: jax.Array


@struct.dataclass
class Replay:
    """Rings [tasks, capacity] and, per task, how many transitions were ever added."""

    rings: Experience
    added: jax.Array  # int32 [tasks]

    @property
    def size(self) -> jax.Array:
        """Transitions each ring holds, int32 [tasks]."""
        return jnp.minimum(self.added, self.rings.terminated.shape[1])


def init(like: Experience, tasks: int, capacity: int) -> Replay:
    """Empty rings; `like` is one item, arrays or their shapes."""
    rings = jax.tree.map(lambda leaf: jnp.zeros((tasks, capacity, *leaf.shape), leaf.dtype), like)
    return Replay(rings, jnp.zeros(tasks, jnp.int32))


def add(replay: Replay, transitions: Transition) -> Replay:
    """Adds [steps, tasks, envs] transitions, each to the ring of its task, in order of time; invalid ones are left out.

    The oldest are overwritten. At most `capacity` may come at once.
    """
    experience = Experience(
        transitions.obs, transitions.action, transitions.next_obs, transitions.outcome, transitions.terminated
    )

    def by_task(leaf: jax.Array) -> jax.Array:
        return jnp.swapaxes(leaf, 0, 1).reshape(leaf.shape[1], -1, *leaf.shape[3:])

    return jax.vmap(_add_to_ring)(replay, jax.tree.map(by_task, experience), by_task(transitions.valid))


def _add_to_ring(replay: Replay, items: Experience, valid: jax.Array) -> Replay:
    """One task's ring and its new items [n]."""
    capacity = replay.rings.terminated.shape[0]
    slot = (replay.added + jnp.cumsum(valid) - 1) % capacity
    slot = jnp.where(valid, slot, capacity)  # past the end: such a write is dropped
    rings = jax.tree.map(lambda ring, item: ring.at[slot].set(item, mode="drop"), replay.rings, items)
    return Replay(rings, replay.added + jnp.sum(valid, dtype=jnp.int32))


def gather(replay: Replay, source: jax.Array, slot: jax.Array) -> Experience:
    """The items in the given slots of the given tasks' rings; `source` and `slot` int32 [n]."""
    return jax.tree.map(lambda ring: ring[source, slot], replay.rings)


def apply_symmetry(symmetry: Symmetry, variant: jax.Array, item: Experience) -> Experience:
    """One item as it would be after a turn or a reflection."""
    obs, next_obs = symmetry.obs(variant, item.obs), symmetry.obs(variant, item.next_obs)
    action, outcome = symmetry.action(variant, item.action), symmetry.outcome(variant, item.outcome)
    return Experience(obs, action, next_obs, outcome, item.terminated)


def recent(replay: Replay, place: jax.Array, window: int) -> tuple[Experience, jax.Array]:
    """Items among the newest `window` of each task's ring, and whether there are any.

    Args:
      replay: the rings.
      place: [tasks, n] in [0, 1), where among them: the newest at 0.
      window: of how many.

    Returns:
      Items [tasks, n], and a bool [tasks, n].
    """
    held = jnp.minimum(replay.size, window)[:, None]
    back = 1 + jnp.minimum((place * held).astype(jnp.int32), jnp.maximum(held - 1, 0))
    slot = (replay.added[:, None] - back) % replay.rings.terminated.shape[1]
    source = jnp.broadcast_to(jnp.arange(len(place))[:, None], place.shape)
    return gather(replay, source, slot), jnp.broadcast_to(held > 0, place.shape)


def standardiser(replay: Replay) -> Standardiser:
    """The mean and spread of the observations held, of which there are some.

    Of a long ring every so-manieth counts: all of a million would cost 5 % of an epoch of the `fast` preset.
    """
    stride = max(1, replay.rings.obs.shape[1] // SAMPLE)
    obs = replay.rings.obs[:, ::stride]
    held = (stride * jnp.arange(obs.shape[1]) < replay.size[:, None])[..., None]  # [tasks, slots, 1]
    count = jnp.sum(held)
    mean = jnp.sum(jnp.where(held, obs, 0.0), (0, 1)) / count
    variance = jnp.sum(jnp.where(held, (obs - mean) ** 2, 0.0), (0, 1)) / count
    return Standardiser(mean, jax.lax.rsqrt(variance + MIN_VARIANCE))
