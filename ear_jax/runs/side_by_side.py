"""Runs that differ in numbers only, and so train side by side in one compiled program."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ear_jax.config import Config, flat, is_on

# Settings that nothing but the equations reads. At 0, those in OFF_AT_ZERO leave a part of the program out.
NUMBERS = (
    *(f"sac.{name}" for name in ("lr", "discount", "pessimism", "tau", "lte_noise", "reward_scale", "return_scale")),
    *("sac.weight_decay", "sac.initial_temperature", "sac.max_grad_norm"),
    *("maml.inner_lr", "maml.max_divergence", "maml.discount", "replay.own_share"),
)
OFF_AT_ZERO = ("sac.return_scale", "sac.weight_decay")


def differing(configs: Sequence[Config]) -> dict[str, np.ndarray]:
    """Returns the numbers in which runs differ, each [members]: the seeds of all runs, run by run."""
    settings = [flat(config) for config in configs]
    values = {name: [each[name] for each in settings] for name in NUMBERS}
    seeds = [config.seeds for config in configs]
    return {
        name: np.repeat(np.asarray(of_runs, np.float32), seeds)
        for name, of_runs in values.items()
        if len(set(of_runs)) > 1
    }


def members(configs: Sequence[Config]) -> Config:
    """Returns the settings of the program that trains runs side by side; its seeds are the members."""
    return replace(configs[0], seeds=sum(config.seeds for config in configs))


def of_run(tree: Any, index: int, runs: int) -> Any:
    """Returns one run's members of a pytree with leaves [members, …], which are arrays or shapes."""
    if runs == 1:
        return tree

    def own(leaf: Any) -> Any:
        seeds = leaf.shape[0] // runs
        if isinstance(leaf, jax.ShapeDtypeStruct):
            return leaf.update(shape=(seeds, *leaf.shape[1:]), sharding=None)
        return leaf[index * seeds : (index + 1) * seeds]

    return jax.tree.map(own, tree)


def join(trees: Sequence[Any]) -> Any:
    """Joins the members of runs; the opposite of `of_run`."""
    return trees[0] if len(trees) == 1 else jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *trees)


def programs(configs: Sequence[Config]) -> list[list[int]]:
    """Groups runs by the program that trains them; returns the indices of each group, in order."""
    groups: dict[tuple[Any, ...], list[int]] = {}
    for index, config in enumerate(configs):
        settings = flat(config)
        switches = {name: is_on(settings[name]) for name in OFF_AT_ZERO}
        key = {**settings, **dict.fromkeys(NUMBERS), **switches}
        groups.setdefault(tuple(key.items()), []).append(index)
    return list(groups.values())
