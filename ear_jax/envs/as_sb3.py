"""Families for Stable-Baselines3, which has an interface of its own for batches of environments."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ear_jax.envs.as_gymnasium import FamilyVectorEnv
from ear_jax.errors import RunError

try:
    from stable_baselines3.common.vec_env import VecEnv
except ImportError:
    raise RunError("Stable-Baselines3 is not installed: pip install stable-baselines3") from None


class FamilyVecEnv(VecEnv):
    """A `FamilyVectorEnv` in the interface of Stable-Baselines3.

    Args:
      envs: the environments, such as `gymnasium.make_vec("ear_jax/HopperVel-v0", num_envs=10)`.
    """

    def __init__(self, envs: FamilyVectorEnv):
        self.envs = envs
        super().__init__(envs.num_envs, envs.single_observation_space, envs.single_action_space)

    def reset(self) -> np.ndarray:
        seed = self._seeds[0]
        self._reset_seeds()
        return self.envs.reset(seed=seed)[0]

    def step_async(self, actions: np.ndarray) -> None:
        self._actions = actions

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        obs, rewards, terminated, truncated, infos = self.envs.step(self._actions)
        own: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for index in np.flatnonzero(terminated | truncated):
            own[index] = {
                "terminal_observation": infos["final_obs"][index],
                "TimeLimit.truncated": bool(truncated[index] and not terminated[index]),
            }
        return obs, rewards.astype(np.float32), terminated | truncated, own

    def close(self) -> None:
        self.envs.close()

    def get_attr(self, attr_name: str, indices: int | Sequence[int] | None = None) -> list[Any]:
        return [getattr(self.envs, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: int | Sequence[int] | None = None) -> None:
        setattr(self.envs, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        return [getattr(self.envs, method_name)(*args, **kwargs)] * len(list(self._get_indices(indices)))

    def env_is_wrapped(self, wrapper_class: type, indices: int | Sequence[int] | None = None) -> list[bool]:
        return [False] * len(list(self._get_indices(indices)))
