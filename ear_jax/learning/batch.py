"""Batches: the transitions an update learns from, and the task each is scored for."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from ear_jax.config import Config
from ear_jax.envs import Family
from ear_jax.envs.symmetry import Symmetry, own_by_symmetry
from ear_jax.errors import UsageError
from ear_jax.learning import replay, return_scale
from ear_jax.learning.replay import Replay
from ear_jax.process.target import on_accelerator
from ear_jax.tasks import TaskParams, task_count


def drawn_tasks(config: Config, tasks: int) -> int:
    """Returns the number of tasks that an update learns from, which is all unless there are more than `meta_batch`."""
    return min(config.meta_batch or tasks, tasks)


def draw_tasks(config: Config, tasks: int, key: jax.Array) -> jax.Array:
    """Draws the tasks of one update without replacement, int32 [drawn]; if they are all, in order."""
    drawn = drawn_tasks(config, tasks)
    if drawn == tasks:
        return jnp.arange(tasks)
    return jax.random.choice(key, tasks, (drawn,), replace=False)


def check_batch(config: Config, tasks: int) -> None:
    """Raises UsageError for a batch or a replay that does not fit the tasks, and for critics that cannot be built."""
    drawn = drawn_tasks(config, tasks)
    if config.sac.batch_size % drawn:
        lower = max(1, config.sac.batch_size // drawn) * drawn
        raise UsageError(
            f"--sac.batch-size {config.sac.batch_size} cannot be split evenly over {drawn} tasks; "
            f"try {lower} or {lower + drawn}"
        )
    epoch = config.collect.envs * config.collect.steps
    if config.replay.capacity // tasks < epoch:
        raise UsageError(
            f"--replay.capacity {config.replay.capacity} holds less than one epoch of {tasks} tasks × {epoch} "
            f"steps; it must be at least {tasks * epoch}"
        )
    if (share := config.sac.batch_size // drawn) % config.sac.policy_share:
        raise UsageError(
            f"--sac.policy-share {config.sac.policy_share} does not divide the {share} transitions that a batch "
            "has of each task"
        )
    if config.network.critic_bins == 1:
        raise UsageError("--network.critic-bins 1 is out of range; it must be 0, for a scalar value, or at least 2")
    if config.network.critic_bins and not config.sac.return_scale:
        raise UsageError("--network.critic-bins needs --sac.return-scale, the largest return that bins reach")
    if config.sac.return_scale and config.sac.discount == 1:
        raise UsageError("--sac.return-scale needs --sac.discount below 1, as a reward for ever must have a return")
    if config.network.critic_batch_norm and config.network.critic_blocks:
        raise UsageError("--network.critic-batch-norm and --network.critic-blocks build other critics; leave out one")


@struct.dataclass
class Noise:
    """Standard normal noise for one evaluation of the policy on a batch."""

    action: jax.Array  # [n, act]
    code: jax.Array  # [n, code]


@struct.dataclass
class Draws:
    """All randomness of one update; drawn for all updates of an epoch at once, which is cheaper."""

    source: jax.Array  # int32 [n]: the task whose ring an item comes from
    variant: jax.Array  # int32 [n]: the symmetry applied to it; 0 changes nothing
    place: jax.Array  # [n] in [0, 1): its position in that ring
    now: Noise  # for the actor's objective
    next: Noise  # for the critics' target


@struct.dataclass
class Batch:
    """Transitions and their rewards, each for one task."""

    obs: jax.Array  # [n, obs]
    action: jax.Array  # [n, act]
    next_obs: jax.Array  # [n, obs]
    reward: jax.Array  # [n], scaled
    outcome: Any  # scalars by name, each [n]
    terminated: jax.Array  # bool [n]
    task: jax.Array  # int32 [n], the task it is scored for


def rows_of_items(table: jax.Array, task: jax.Array) -> jax.Array:
    """Returns the row of each item's task.

    On an accelerator rows are repeated instead of gathered: gradients then need a sum and no scatter.

    Args:
      table: [tasks, …], or a scalar for all tasks, which is returned.
      task: int32 [n], in order and each task equally often, as in every batch.
    """
    if not table.ndim:
        return table
    if not on_accelerator():
        return table[task]
    share = len(task) // len(table)
    return jnp.broadcast_to(table[:, None], (len(table), share, *table.shape[1:])).reshape(-1, *table.shape[1:])


@dataclass(frozen=True)
class Batches:
    """Draws batches that hold equally many items for every task."""

    family: Family
    tasks: TaskParams  # each leaf [tasks]
    config: Config
    code_size: int

    @property
    def symmetry(self) -> Symmetry | None:
        """The family's symmetry if `replay.symmetry` is set."""
        return self.family.symmetry if self.config.replay.symmetry else None

    def reward_scale(self, buffer: Replay) -> float | jax.Array:
        """Returns the factor on rewards: `sac.reward_scale`, or with `sac.return_scale` one for each task [tasks]."""
        if buffer.largest is None:
            return self.config.sac.reward_scale
        return return_scale.reward_scale(self.config.sac, buffer.largest)

    def item_tasks(self) -> jax.Array:
        """Returns the task that each item of a batch is scored for, int32 [n]."""
        count = task_count(self.tasks)
        return jnp.repeat(jnp.arange(count), self.config.sac.batch_size // count)

    def draw(self, key: jax.Array, updates: int, tasks: jax.Array | None = None) -> Draws:
        """Draws the randomness of `updates` updates, each leaf [updates, n, …].

        Args:
          key: a random key.
          updates: their number.
          tasks: int32 [updates, drawn], the tasks of each; all by default.
        """
        n, settings = self.config.sac.batch_size, self.config.replay
        keys = jax.random.split(key, 7)  # PEARL's learner uses keys[5]
        if tasks is None:
            tasks = jnp.broadcast_to(jnp.arange(task_count(self.tasks)), (updates, task_count(self.tasks)))
        source, variant = jnp.repeat(tasks, n // tasks.shape[1], axis=1), jnp.zeros((updates, n), jnp.int32)
        if self.symmetry:
            source, variant = own_by_symmetry(self.symmetry, self.tasks, keys[6], source)
        if settings.share_experience:
            shared = jax.random.randint(keys[0], (updates, n), 0, task_count(self.tasks))
            source = jnp.where(jax.random.uniform(keys[1], (updates, n)) < settings.own_share, source, shared)
        place = jax.random.uniform(keys[2], (updates, n))
        return Draws(source, variant, place, self._noise(keys[3], updates), self._noise(keys[4], updates))

    def _noise(self, key: jax.Array, updates: int) -> Noise:
        key_action, key_code = jax.random.split(key)
        n = self.config.sac.batch_size
        return Noise(
            jax.random.normal(key_action, (updates, n, self.family.action_size)),
            jax.random.normal(key_code, (updates, n, self.code_size)),
        )

    def take(self, buffer: Replay, draws: Draws) -> Batch:
        """Gathers the drawn transitions and scores each for its item's task, whichever task it was collected in."""
        task = self.item_tasks()
        size = buffer.size[draws.source]
        slot = jnp.minimum((draws.place * size).astype(jnp.int32), size - 1)
        items = replay.gather(buffer, draws.source, slot)
        if self.symmetry:
            items = jax.vmap(partial(replay.apply_symmetry, self.symmetry))(draws.variant, items)
        params = jax.tree.map(lambda leaf: rows_of_items(leaf, task), self.tasks)
        scale = self.reward_scale(buffer)
        scale = rows_of_items(scale, task) if isinstance(scale, jax.Array) else scale
        reward = scale * jax.vmap(self.family.reward)(items.outcome, params)
        return Batch(items.obs, items.action, items.next_obs, reward, items.outcome, items.terminated, task)
