"""Symmetries of a robot: ways to turn or mirror a step after which physics is as true of it as before."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np


@dataclass(frozen=True)
class Signed:
    """Signed permutations of a vector, a variant each; variant 0 changes nothing."""

    order: np.ndarray  # int [variants, size]
    sign: np.ndarray  # float32 [variants, size]

    def __call__(self, variant: jax.Array, vector: jax.Array) -> jax.Array:
        """The variant of a vector [size], or of several laid end to end."""
        each = vector.reshape(-1, self.order.shape[1])
        return (each[:, jnp.asarray(self.order)[variant]] * jnp.asarray(self.sign)[variant]).ravel()


@dataclass(frozen=True)
class Symmetry:
    """What each variant makes of a step's parts and of a task: the step then does for that task what it did for its."""

    variants: int
    obs: Signed
    action: Signed
    outcome: Callable[[jax.Array, dict[str, jax.Array]], dict[str, jax.Array]]  # variant, outcome
    task: Callable[[jax.Array, dict[str, jax.Array]], dict[str, jax.Array]]  # variant, a task's parameters


Moved = tuple[int, ...]


def turns_and_flips(parts: Sequence[tuple[Moved, Moved]], turns: int) -> Signed:
    """All of so many turns, each without and with a flip first; [2 · turns, size].

    Args:
      parts: of a vector, in their order, each told by what a turn and what a flip makes of it: place by place, the
        number of the place in the part, counted from 1, that is found there afterwards, negative where its sign
        changes.
      turns: how many lead round.
    """
    sizes = [len(turn) for turn, _ in parts]
    before = np.repeat(np.cumsum(sizes) - sizes, sizes)  # of each place, how many the parts before it have
    turn, flip = (np.sign(way) * (np.abs(way) + before) for way in map(np.concatenate, zip(*parts, strict=True)))
    found = []
    for start in (np.arange(1, len(turn) + 1), flip):
        for _ in range(turns):
            found.append(start)
            start = start[np.abs(turn) - 1] * np.sign(turn)
    table = np.stack(found)
    return Signed(np.abs(table) - 1, np.sign(table).astype(np.float32))


def pair(signed: Signed, names: tuple[str, str]) -> Callable[[jax.Array, dict[str, jax.Array]], dict[str, jax.Array]]:
    """Turns two named numbers as the vector that they are, and leaves the others as they are."""

    def turned(variant: jax.Array, numbers: dict[str, jax.Array]) -> dict[str, jax.Array]:
        vector = signed(variant, jnp.stack([numbers[name] for name in names]))
        return {**numbers, names[0]: vector[0], names[1]: vector[1]}

    return turned


def own_by_symmetry(
    symmetry: Symmetry, tasks: dict[str, jax.Array], key: jax.Array, task: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Random variants, and of which task a transition has to be for its variant to be one of the task given.

    Args:
      symmetry: of the family.
      tasks: parameters, each leaf [tasks].
      key: seeds the choice.
      task: int32, any shape.

    Returns:
      Tasks and variants, of that shape; the same task and variant 0 where no task would do.
    """
    source, exists = origins(symmetry, tasks)
    variant = jax.random.randint(key, task.shape, 0, symmetry.variants)
    variant = jnp.where(exists[variant, task], variant, 0)
    return source[variant, task], variant


def origins(symmetry: Symmetry, tasks: dict[str, jax.Array]) -> tuple[jax.Array, jax.Array]:
    """Which task becomes which.

    Args:
      symmetry: of the family.
      tasks: parameters, each leaf [tasks].

    Returns:
      For each variant and task the task that it makes that one of, int32 [variants, tasks], and whether there is one.
    """
    variants = jnp.arange(symmetry.variants)
    turned = jax.vmap(lambda variant: jax.vmap(lambda task: symmetry.task(variant, task))(tasks))(variants)
    # How far each is from each, [variants, from, to].
    apart = sum(jnp.abs(turned[name][:, :, None] - tasks[name][None, None, :]) for name in tasks)
    return jnp.argmin(apart, axis=1).astype(jnp.int32), jnp.min(apart, axis=1) < 1e-4
