"""Symmetries of a robot: rotations and mirror images of a step under which its physics still holds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np


@dataclass(frozen=True)
class Signed:
    """Signed permutations of a vector, one per variant; variant 0 is the identity."""

    order: np.ndarray  # int [variants, size]
    sign: np.ndarray  # float32 [variants, size]

    def __call__(self, variant: jax.Array, vector: jax.Array) -> jax.Array:
        """Applies a variant to a vector [size], or to several concatenated."""
        each = vector.reshape(-1, self.order.shape[1])
        return (each[:, jnp.asarray(self.order)[variant]] * jnp.asarray(self.sign)[variant]).ravel()

    def select(self, one_hot: jax.Array, vector: jax.Array) -> jax.Array:
        """Applies the variant that a one-hot [variants] selects, by sums and products only."""
        each = vector.reshape(-1, self.order.shape[1])
        return jnp.sum(one_hot[:, None] * each[:, self.order] * self.sign, axis=1).ravel()

    @property
    def inverse(self) -> Signed:
        """The inverse of each variant."""
        order = np.argsort(self.order, axis=1)
        return Signed(order, np.take_along_axis(self.sign, order, axis=1))

    @property
    def unsigned(self) -> Signed:
        """The permutations without their signs, for scales such as σ."""
        return Signed(self.order, np.abs(self.sign))


@dataclass(frozen=True)
class Symmetry:
    """Maps by which a variant changes a step and a task; the new step has the old reward under the new task."""

    variants: int
    obs: Signed
    action: Signed
    plane: Signed  # vectors of the ground plane, [2]
    velocity: tuple[str, str]  # the plane vector in an outcome
    direction: tuple[str, str]  # and in a task's params

    def outcome(self, variant: jax.Array, outcome: dict[str, jax.Array]) -> dict[str, jax.Array]:
        """Applies a variant to an outcome."""
        return _turned(self.plane, variant, outcome, self.velocity)

    def task(self, variant: jax.Array, params: dict[str, jax.Array]) -> dict[str, jax.Array]:
        """Applies a variant to a task's params."""
        return _turned(self.plane, variant, params, self.direction)


SignedOrder = tuple[int, ...]  # a signed permutation: numbers from 1, negative where the sign changes


def turns_and_flips(parts: Sequence[tuple[SignedOrder, SignedOrder]], turns: int) -> Signed:
    """Builds the group of rotations and mirror images, [2 · turns, size]: each turn, without and after a flip.

    Args:
      parts: a vector's parts in order, each with its signed permutation by one turn and by the flip. Entry i is the
        number, from 1 within the part, of the entry that moves to i.
      turns: turns in a full rotation.
    """
    sizes = [len(turn) for turn, _ in parts]
    offset = np.repeat(np.cumsum(sizes) - sizes, sizes)  # of each entry's part within the vector
    turn, flip = (np.sign(order) * (np.abs(order) + offset) for order in map(np.concatenate, zip(*parts, strict=True)))
    orders = []
    for order in (np.arange(1, len(turn) + 1), flip):
        for _ in range(turns):
            orders.append(order)
            order = order[np.abs(turn) - 1] * np.sign(turn)
    table = np.stack(orders)
    return Signed(np.abs(table) - 1, np.sign(table).astype(np.float32))


def _turned(
    plane: Signed, variant: jax.Array, numbers: dict[str, jax.Array], names: tuple[str, str]
) -> dict[str, jax.Array]:
    vector = plane(variant, jnp.stack([numbers[name] for name in names]))
    return {**numbers, names[0]: vector[0], names[1]: vector[1]}


def own_by_symmetry(
    symmetry: Symmetry, tasks: dict[str, jax.Array], key: jax.Array, task: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Draws random variants, and the tasks whose transitions they map to the given tasks.

    Args:
      symmetry: the family's.
      tasks: params, each leaf [tasks].
      key: a random key.
      task: int32, any shape.

    Returns:
      Source tasks and variants, of that shape; the task itself and variant 0 if no task maps to it.
    """
    source, exists = origins(symmetry, tasks)
    variant = jax.random.randint(key, task.shape, 0, symmetry.variants)
    variant = jnp.where(exists[variant, task], variant, 0)
    return source[variant, task], variant


def origins(symmetry: Symmetry, tasks: dict[str, jax.Array]) -> tuple[jax.Array, jax.Array]:
    """Finds, for each variant and task, the task that the variant maps to it.

    Args:
      symmetry: the family's.
      tasks: params, each leaf [tasks].

    Returns:
      That task, int32 [variants, tasks], and whether there is one, bool [variants, tasks].
    """
    variants = jnp.arange(symmetry.variants)
    mapped = jax.vmap(lambda variant: jax.vmap(lambda task: symmetry.task(variant, task))(tasks))(variants)
    # Distances [variants, source task, task].
    distance = sum(jnp.abs(mapped[name][:, :, None] - tasks[name][None, None, :]) for name in tasks)
    return jnp.argmin(distance, axis=1).astype(jnp.int32), jnp.min(distance, axis=1) < 1e-4
