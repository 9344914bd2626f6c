"""Task families, one file each, found by name."""

from ear_jax.envs.family import Family
from ear_jax.envs.registry import FAMILIES, find_family, find_task, make_family, spread_tasks

__all__ = ["FAMILIES", "Family", "find_family", "find_task", "make_family", "spread_tasks"]
