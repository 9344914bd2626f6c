"""Rings of transitions whose every field is a number of its own, so that a wrong gather shows."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from ear_jax.envs.batched_env import Transition
from ear_jax.learning import replay

TASKS, ENVS, CAPACITY = 3, 2, 10


def transitions(first_step: int, steps: int, valid=None) -> Transition:
    """Returns transitions whose fields are 1000 t + 100 e + s and a fraction, for task t, environment e, step s."""
    step, task, env = jnp.meshgrid(
        jnp.arange(first_step, first_step + steps), jnp.arange(TASKS), jnp.arange(ENVS), indexing="ij"
    )
    number = (1000.0 * task + 100.0 * env + step).astype(jnp.float32)
    flags = jnp.zeros(number.shape, bool)
    return Transition(
        obs=jnp.stack([number, number + 0.1], -1),
        action=number[..., None] + 0.2,
        next_obs=jnp.stack([number + 0.3, number + 0.4], -1),
        outcome={"x": number + 0.5},
        terminated=(step % 2).astype(bool),
        truncated=flags,
        valid=~flags if valid is None else valid,
    )


def empty() -> replay.Replay:
    item = replay.Experience(jnp.zeros(2), jnp.zeros(1), jnp.zeros(2), {"x": jnp.zeros(())}, jnp.zeros((), bool))
    return replay.init(item, TASKS, CAPACITY)


def numbers(buffer: replay.Replay, task: int) -> list[int]:
    return sorted(buffer.rings.obs[task, : buffer.size[task], 0].astype(int).tolist())


def test_gather_returns_whole_items_of_the_asked_task_and_slot():
    buffer = jax.jit(replay.add)(empty(), transitions(0, 5))
    source, slot = jnp.array([0, 1, 2, 2, 1]), jnp.array([0, 9, 3, 4, 5])
    items = replay.gather(buffer, source, slot)
    # Within a ring time comes first: slot 2 s + e.
    expected = 1000 * source + 100 * (slot % 2) + slot // 2
    np.testing.assert_allclose(items.obs[:, 0], expected)
    np.testing.assert_allclose(items.obs[:, 1], expected + 0.1, rtol=1e-6)
    np.testing.assert_allclose(items.action[:, 0], expected + 0.2, rtol=1e-6)
    np.testing.assert_allclose(items.next_obs[:, 0], expected + 0.3, rtol=1e-6)
    np.testing.assert_allclose(items.outcome["x"], expected + 0.5, rtol=1e-6)
    np.testing.assert_array_equal(items.terminated, slot // 2 % 2)


def test_the_oldest_are_overwritten():
    add = jax.jit(replay.add)
    buffer = empty()
    for first in range(0, 12, 3):
        buffer = add(buffer, transitions(first, 3))
    assert buffer.size.tolist() == [CAPACITY] * TASKS
    assert buffer.added.tolist() == [24] * TASKS
    for task in range(TASKS):
        assert numbers(buffer, task) == [1000 * task + 100 * env + step for env in range(2) for step in range(7, 12)]


def test_invalid_transitions_leave_no_trace():
    valid = jnp.ones((3, TASKS, ENVS), bool).at[1, 0, 1].set(False).at[:, 2].set(False)
    buffer = replay.add(empty(), transitions(0, 3, valid))
    assert buffer.size.tolist() == [5, 6, 0]
    assert numbers(buffer, 0) == [0, 1, 2, 100, 102]
    more = replay.add(buffer, transitions(3, 3))
    assert more.size.tolist() == [CAPACITY, CAPACITY, 6]
    assert 101 not in numbers(more, 0)


def holding(obs: np.ndarray, added: list[int]) -> replay.Replay:
    """Returns rings of observations [tasks, capacity, obs] and nothing else."""
    nothing = jnp.zeros(obs.shape[:2])
    return replay.Replay(replay.Experience(jnp.asarray(obs), nothing, nothing, {}, nothing), jnp.array(added))


def test_standardiser_is_of_what_rings_hold():
    seen = np.random.default_rng(0).normal(3.0, 2.0, size=(2, 8, 2)).astype(np.float32)
    found = replay.standardiser(holding(seen, added=[5, 20]))  # the first ring is not full, the second was overwritten
    expected = np.concatenate([seen[0, :5], seen[1]])
    np.testing.assert_allclose(found.mean, expected.mean(0), rtol=1e-5)
    np.testing.assert_allclose(found.scale, 1 / np.sqrt(expected.var(0) + 1e-4), rtol=1e-5)
    np.testing.assert_allclose(found(jnp.asarray(expected)).std(0), 1, atol=1e-3)


def test_standardiser_of_long_rings_goes_by_a_sample():
    capacity = 3 * replay.SAMPLE
    ramp = np.arange(capacity, dtype=np.float32)[None, :, None]
    found = replay.standardiser(holding(ramp, added=[capacity]))
    np.testing.assert_allclose(found.mean, (capacity - 3) / 2, rtol=1e-5)
