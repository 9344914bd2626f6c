"""One program for several seeds: vmapped or looped over on a device, sharded over devices, also of several hosts."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from ear_jax.config import Config
from ear_jax.errors import UsageError
from ear_jax.process import hosts
from ear_jax.process.runtime import compiler_options

AXIS = "seeds"


def seed_range(config: Config) -> str:
    """Names a run's seeds: seed 3, or seeds 0–4."""
    return f"seed {config.seed}" if config.seeds == 1 else f"seeds {config.seed}–{config.seed + config.seeds - 1}"


def check_seeds(seeds: int) -> None:
    """Raises UsageError unless the seeds of a program can be spread evenly over hosts."""
    if seeds % hosts.count():
        raise UsageError(
            f"{seeds} seeds cannot be spread evenly over {hosts.count()} hosts; their number must be a multiple of it"
        )


def devices_for(seeds: int) -> int:
    """Returns the largest number of a host's devices that divides its share of the seeds evenly."""
    share = seeds // hosts.count()
    return max(count for count in range(1, jax.local_device_count() + 1) if share % count == 0)


def seed_sharding(seeds: int) -> NamedSharding:
    """Returns the sharding of leaves [seeds, …] over devices: each host has its seeds, in the order of its index."""
    used = devices_for(seeds)
    of_hosts = ([device for device in jax.devices() if device.process_index == host] for host in range(hosts.count()))
    devices = [device for of_host in of_hosts for device in of_host[:used]]
    return NamedSharding(Mesh(devices, (AXIS,)), PartitionSpec(AXIS))


def spread(values: np.ndarray) -> jax.Array:
    """Spreads an array [seeds, …], which every process has, over devices: each gets that of its seeds."""
    return jax.make_array_from_callback(values.shape, seed_sharding(len(values)), lambda index: values[index])


def own_members(tree: Any) -> Any:
    """Returns this host's seeds of a pytree with leaves [seeds, …], as arrays of NumPy."""
    if hosts.count() == 1:
        return jax.device_get(tree)
    leaves, structure = jax.tree.flatten(tree)
    parts = [[shard.data for shard in sorted(leaf.addressable_shards, key=_first)] for leaf in leaves]
    return jax.tree.unflatten(structure, [np.concatenate(part) for part in jax.device_get(parts)])


def _first(shard: jax.Shard) -> int:
    """Returns the first of the seeds that a shard holds."""
    return shard.index[0].start or 0


def over_seeds(
    function: Callable[..., Any],
    seeds: int,
    matmul: str = "float32",
    in_turn: bool = False,
    **options: Any,
) -> Any:
    """Compiles a function of one seed for all of them.

    Devices run their own seeds independently: none waits for another, and the native engine calls the host once per
    device.

    Args:
      function: for one seed; its arguments and results get a leading axis [seeds].
      seeds: the number of seeds.
      matmul: the precision of most of its matmuls, as in `network.matmul`.
      in_turn: a device computes its seeds one after the other, not as one batch. A CPU's caches hold the networks of
        one or two seeds, so that eight at once cost more than eight in turn.
      options: further options of `jax.jit`.
    """
    mapped = partial(_one_by_one, function) if in_turn and seeds > 1 else jax.vmap(function)
    sharding = seed_sharding(seeds)
    options["compiler_options"] = compiler_options(matmul)
    if sharding.num_devices == 1:
        return jax.jit(mapped, **options)
    sharded = jax.shard_map(
        mapped,
        mesh=sharding.mesh,
        in_specs=sharding.spec,
        out_specs=sharding.spec,
        check_vma=False,  # not supported for the native engine's callbacks
    )
    return jax.jit(sharded, in_shardings=sharding, out_shardings=sharding, **options)


def _one_by_one(function: Callable[..., Any], *arguments: Any) -> Any:
    return jax.lax.map(lambda each: function(*each), arguments)
