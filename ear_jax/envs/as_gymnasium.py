"""Families as environments of Gymnasium: a batch as a vector environment, and one robot as an environment."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from ear_jax.envs.batched_env import BatchedEnv, EnvState
from ear_jax.envs.family import Family
from ear_jax.envs.registry import find_task, make_family
from ear_jax.errors import UsageError
from ear_jax.tasks import TaskSet, task_set

Infos = dict[str, Any]


class FamilyVectorEnv(VectorEnv):
    """A batch of environments of one family, stepped together in one compiled call.

    Environment i always does task i modulo the number of tasks. With several tasks an observation ends with the one-hot
    of its task. An environment whose episode ends starts again in the same step (`AutoresetMode.SAME_STEP`): the state
    that it reached is `infos["final_obs"]`. `terminated` means that the robot failed, `truncated` that time ran out.
    A step whose numbers are not finite counts as truncated with reward 0, and is marked in `infos["invalid"]`.

    Args:
      family: a family, its name, or path/to/file.py:ClassName.
      num_envs: environments, at least one for each task.
      tasks: names of tasks, such as 1 and 2.5; all training tasks by default.
      engine: physics engine: auto, native (CPU), mjx, mjx-fixed or warp.
    """

    metadata: Infos = {"autoreset_mode": AutoresetMode.SAME_STEP, "render_modes": []}  # noqa: RUF012

    def __init__(self, family: str | Family, num_envs: int = 1, tasks: Sequence[str] = (), engine: str = "auto"):
        self.family = make_family(family, engine) if isinstance(family, str) else family
        self.tasks = _tasks(self.family, tasks)
        if num_envs < len(self.tasks):
            count = len(self.tasks)
            raise UsageError(f"num_envs={num_envs} is too few for {count} tasks; take {count} or name fewer in tasks=…")
        self.num_envs = num_envs
        self.single_observation_space, self.single_action_space = _spaces(self.family, len(self.tasks))
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        rows = np.arange(num_envs) % len(self.tasks)
        self.task_names = [self.tasks.names[row] for row in rows]  # of each environment
        self._one_hots = np.eye(len(self.tasks))[rows] if len(self.tasks) > 1 else np.zeros((num_envs, 0))
        params = jax.tree.map(lambda leaf: leaf[rows], self.tasks.params)
        batch = BatchedEnv(self.family)
        self._start = jax.jit(lambda key: batch.start(key, params, 1))
        self._step = jax.jit(partial(_step, batch))
        self._env_states: EnvState | None = None

    def reset(self, *, seed: int | None = None, options: Infos | None = None) -> tuple[np.ndarray, Infos]:
        """Starts all episodes at random; returns observations [num_envs, obs] and infos."""
        super().reset(seed=seed)
        self._env_states = self._start(_key(self.np_random))
        return self._observed(self._env_states.state.obs[:, 0]), {}

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, Infos]:
        """Steps all environments with actions [num_envs, act] in [−1, 1].

        Returns:
          Observations [num_envs, obs], rewards, terminations and truncations [num_envs], and infos: the outcome of each
          step by name, and `final_obs` where an episode ended.
        """
        if self._env_states is None:
            raise gymnasium.error.ResetNeeded("call reset before step")
        if np.shape(actions) != self.action_space.shape:
            raise UsageError(f"actions must have shape {self.action_space.shape}, but have {np.shape(actions)}")
        self._env_states, step = self._step(self._env_states, jnp.asarray(actions, jnp.float32))
        step = jax.device_get(step)
        infos: Infos = {}
        for name, values in step["outcome"].items():
            infos |= {name: values, f"_{name}": np.ones(self.num_envs, bool)}
        over = step["terminated"] | step["truncated"]
        if over.any():
            final = np.full(self.num_envs, None, object)
            reached = self._observed(step["reached"])
            for index in np.flatnonzero(over):
                final[index] = reached[index]
            infos |= {"final_info": dict(infos), "_final_info": over, "final_obs": final, "_final_obs": over}
            infos |= {"invalid": step["invalid"], "_invalid": over}
        obs, reward = self._observed(step["obs"]), step["reward"].astype(np.float64)
        return obs, reward, step["terminated"], step["truncated"], infos

    def _observed(self, obs: Any) -> np.ndarray:
        return np.concatenate([np.asarray(obs, np.float32), self._one_hots], axis=1, dtype=np.float32)


class FamilyEnv(gymnasium.Env):
    """One robot of a family on one task; steps and infos are as in `FamilyVectorEnv`, and no episode starts by itself.

    Args:
      family: a family's name, or path/to/file.py:ClassName.
      task: a task's name; the first training task by default.
      engine: physics engine: auto, native (CPU), mjx, mjx-fixed or warp.
    """

    metadata: Infos = {"render_modes": []}  # noqa: RUF012

    def __init__(self, family: str, task: str | None = None, engine: str = "auto"):
        made = make_family(family, engine)
        self._batch = FamilyVectorEnv(made, tasks=(task or made.training_tasks().names[0],))
        self.observation_space = self._batch.single_observation_space
        self.action_space = self._batch.single_action_space

    def reset(self, *, seed: int | None = None, options: Infos | None = None) -> tuple[np.ndarray, Infos]:
        """Starts an episode at random; returns the observation [obs] and infos."""
        super().reset(seed=seed)
        obs, infos = self._batch.reset(seed=int(self.np_random.integers(2**31)))
        return obs[0], infos

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, Infos]:
        """Steps the robot with an action [act] in [−1, 1]; the observation [obs] is that of the state reached."""
        obs, reward, terminated, truncated, infos = self._batch.step(action[None])
        reached = infos["final_obs"][0] if "final_obs" in infos else None
        left_out = ("final_obs", "final_info")
        own = {name: value[0] for name, value in infos.items() if not name.startswith("_") and name not in left_out}
        return obs[0] if reached is None else reached, float(reward[0]), bool(terminated[0]), bool(truncated[0]), own


def _tasks(family: Family, names: Sequence[str]) -> TaskSet:
    if isinstance(names, str):
        raise UsageError(f"tasks={names!r} must be a list of names, as in tasks=[{names!r}]")
    if other := [name for name in names if not isinstance(name, str)]:
        raise UsageError(f"a task is named by text, as in {str(other[0])!r}, not by {other[0]!r}")
    return task_set([find_task(family, name) for name in names]) if len(names) else family.training_tasks()


def _spaces(family: Family, tasks: int) -> tuple[Box, Box]:
    size = family.observation_size + (tasks if tasks > 1 else 0)
    return Box(-np.inf, np.inf, (size,), np.float32), Box(-1.0, 1.0, (family.action_size,), np.float32)


def _key(random: np.random.Generator) -> jax.Array:
    return jax.random.key(int(random.integers(2**31)))


def _step(batch: BatchedEnv, env_states: EnvState, action: jax.Array) -> tuple[EnvState, dict[str, Any]]:
    """Steps a batch [rows, 1]; `action` is [rows, act]."""
    task = jax.tree.map(lambda leaf: leaf[:, 0], env_states.state.info["task"])
    after, transition = batch.step(env_states, action[:, None])
    step = jax.tree.map(lambda leaf: leaf[:, 0], transition)
    reward = jax.vmap(batch.family.reward)(step.outcome, task)
    return after, {
        "obs": after.state.obs[:, 0],
        "reached": jnp.where(step.valid[:, None], step.next_obs, step.obs),
        "outcome": step.outcome,
        "reward": jnp.where(step.valid, reward, 0.0),
        "terminated": step.terminated,
        "truncated": step.truncated | ~step.valid,
        "invalid": ~step.valid,
    }
