"""The [task, env] batch: many environments of one family, each with a time limit and random resets."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
from flax import struct

from ear_jax.envs.environment import State
from ear_jax.envs.family import Family, Outcome
from ear_jax.tasks import TaskParams, task_count


@struct.dataclass
class EnvState:
    """One environment and its episode clock."""

    state: State
    steps: jax.Array  # int32, steps since the episode began


@struct.dataclass
class Transition:
    """One environment step; `next_obs` is the state reached, even if the environment was reset afterwards."""

    obs: jax.Array  # [obs]
    action: jax.Array  # [act]
    next_obs: jax.Array  # [obs]
    outcome: Outcome  # scalars by name
    terminated: jax.Array  # bool: the robot failed, so the next state has no value
    truncated: jax.Array  # bool: only the time limit was reached, which is not a termination
    valid: jax.Array  # bool: all numbers are finite; otherwise the step must not be learnt from

    @property
    def failed(self) -> jax.Array:
        """True where the step ends an episode before its time, by the robot's failure or by the simulation's."""
        return self.terminated | ~self.valid


@dataclass(frozen=True)
class BatchedEnv:
    """Runs a batch of environments [rows, envs]; all environments of a row share a task."""

    family: Family
    resets: bool = True  # restart an environment whose episode has ended; without, a step takes half as long to compile

    def start(self, key: jax.Array, tasks: TaskParams, envs: int, stagger: bool = False) -> EnvState:
        """Resets all environments to random starts.

        Args:
          key: a random key.
          tasks: each leaf [rows].
          envs: environments per row.
          stagger: start the clocks at random within an episode, so that episodes do not all end together.

        Returns:
          The environments, each leaf [rows, envs, …].
        """
        rows = task_count(tasks)
        key_state, key_clock = jax.random.split(key)
        keys = jax.random.split(key_state, (rows, envs))
        state = jax.vmap(jax.vmap(self.family.start, in_axes=(0, None)))(keys, tasks)
        steps = jnp.zeros((rows, envs), jnp.int32)
        if stagger:
            steps = jax.random.randint(key_clock, (rows, envs), 0, self.family.episode_length)
        return EnvState(state, steps)

    def step(self, env_states: EnvState, action: jax.Array) -> tuple[EnvState, Transition]:
        """Steps the batch; `action` is [rows, envs, act]."""
        return jax.vmap(jax.vmap(self._step_one))(env_states, action)

    def _step_one(self, env_state: EnvState, action: jax.Array) -> tuple[EnvState, Transition]:
        after = self.family.step(env_state.state, action)
        steps = env_state.steps + 1
        valid = is_finite((after.pipeline_state, after.obs, after.metrics, after.reward, action))
        terminated = (after.done > 0) & valid
        truncated = (steps >= self.family.episode_length) & ~terminated & valid
        transition = Transition(env_state.state.obs, action, after.obs, after.metrics, terminated, truncated, valid)
        if not self.resets:
            return EnvState(after, steps), transition
        key_start, key_later = jax.random.split(env_state.state.info["key"])
        fresh = self.family.start(key_start, env_state.state.info["task"])
        continued = replace(after, info={**after.info, "key": key_later})
        reset = terminated | truncated | ~valid
        env_state = jax.tree.map(
            lambda new, old: jnp.where(reset, new, old), EnvState(fresh, jnp.int32(0)), EnvState(continued, steps)
        )
        return env_state, transition


def is_finite(numbers: Any) -> jax.Array:
    """Returns whether all numbers of a pytree are finite and below 1e10, MuJoCo's own limit; a scalar bool."""
    return jnp.all(jnp.array([jnp.all(jnp.abs(leaf) < mujoco.mjMAXVAL) for leaf in jax.tree.leaves(numbers)]))
