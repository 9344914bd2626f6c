"""Runs that differ in numbers only, and so train side by side in one compiled program."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import NamedSharding, PartitionSpec

from ear_jax.config import Config, flat, is_on
from ear_jax.process import hosts
from ear_jax.process.streams import libraries_muted
from ear_jax.runs.seeds import seed_sharding
from ear_jax.runs.training import seed_keys

# Settings that nothing but the equations reads. At 0, those in OFF_AT_ZERO leave a part of the program out.
NUMBERS = (
    *(f"sac.{name}" for name in ("lr", "discount", "pessimism", "tau", "lte_noise", "reward_scale", "return_scale")),
    *("sac.weight_decay", "sac.outcome_weight", "sac.initial_temperature", "sac.max_grad_norm"),
    *("maml.inner_lr", "maml.max_divergence", "maml.discount", "maml.gae_lambda", "replay.own_share"),
)
OFF_AT_ZERO = ("sac.return_scale", "sac.weight_decay", "sac.outcome_weight")


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


def keys_of(configs: Sequence[Config]) -> jax.Array:
    """Returns the initial keys of the seeds of all runs, [members]."""

    def keys() -> jax.Array:
        return jnp.concatenate([seed_keys(config) for config in configs])

    if hosts.count() == 1:
        return keys()
    seeds = sum(config.seeds for config in configs)
    with libraries_muted():  # the first program over hosts connects them
        return jax.block_until_ready(jax.jit(keys, out_shardings=seed_sharding(seeds))())


def over_hosts(seeds: int) -> NamedSharding | None:
    """Returns the sharding of one run's leaves [seeds, …] over hosts; None on one host.

    Seeds that cannot be spread evenly are on every device.
    """
    if hosts.count() == 1:
        return None
    if seeds % hosts.count() == 0:
        return seed_sharding(seeds)
    return NamedSharding(seed_sharding(hosts.count()).mesh, PartitionSpec())


def of_run(tree: Any, index: int, runs: int) -> Any:
    """Returns one run's members of a pytree with leaves [members, …], which are arrays or shapes."""
    if runs == 1:
        return tree

    def own(leaf: Any) -> Any:
        seeds = leaf.shape[0] // runs
        if isinstance(leaf, jax.ShapeDtypeStruct):
            return leaf.update(shape=(seeds, *leaf.shape[1:]), sharding=None)
        sharding, part = over_hosts(seeds), slice(index * seeds, (index + 1) * seeds)
        return leaf[part] if sharding is None else jax.jit(lambda leaf: leaf[part], out_shardings=sharding)(leaf)

    return jax.tree.map(own, tree)


def join(trees: Sequence[Any], sharding: NamedSharding) -> Any:
    """Joins the members of runs, the opposite of `of_run`, and spreads them over devices."""

    def concatenate(*leaves: jax.Array) -> jax.Array:
        return jnp.concatenate(leaves)

    if hosts.count() > 1:
        concatenate = jax.jit(concatenate, out_shardings=sharding)
    joined = trees[0] if len(trees) == 1 else jax.tree.map(concatenate, *trees)
    return joined if hosts.count() > 1 else jax.device_put(joined, sharding)


def programs(configs: Sequence[Config]) -> list[list[int]]:
    """Groups runs by the program that trains them; returns the indices of each group, in order."""
    groups: dict[tuple[Any, ...], list[int]] = {}
    for index, config in enumerate(configs):
        settings = flat(config)
        switches = {name: is_on(settings[name]) for name in OFF_AT_ZERO}
        key = {**settings, **dict.fromkeys(NUMBERS), **switches}
        groups.setdefault(tuple(key.items()), []).append(index)
    return list(groups.values())
