"""One program for several seeds: vmapped on a device, and sharded over several devices."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from ear_jax.config import Config
from ear_jax.process.runtime import compiler_options

AXIS = "seeds"


def seed_range(config: Config) -> str:
    """Names a run's seeds: seed 3, or seeds 0–4."""
    return f"seed {config.seed}" if config.seeds == 1 else f"seeds {config.seed}–{config.seed + config.seeds - 1}"


def devices_for(seeds: int) -> int:
    """Returns the largest number of devices that divides the seeds evenly."""
    return max(count for count in range(1, jax.local_device_count() + 1) if seeds % count == 0)


def seed_sharding(seeds: int) -> NamedSharding:
    """Returns the sharding of leaves [seeds, …] over devices."""
    mesh = Mesh(jax.local_devices()[: devices_for(seeds)], (AXIS,))
    return NamedSharding(mesh, PartitionSpec(AXIS))


def over_seeds(
    function: Callable[..., Any],
    seeds: int,
    in_axes: tuple[int | None, ...],
    matmul: str = "float32",
    **options: Any,
) -> Any:
    """Compiles a function of one seed for all of them.

    Devices run their own seeds independently: none waits for another, and the native engine calls the host once per
    device.

    Args:
      function: for one seed; its results get a leading axis [seeds].
      seeds: the number of seeds.
      in_axes: for each argument 0 if it has an axis [seeds], else None.
      matmul: the precision of most of its matmuls, as in `network.matmul`.
      options: further options of `jax.jit`.
    """
    mapped, sharding = jax.vmap(function, in_axes), seed_sharding(seeds)
    options["compiler_options"] = compiler_options(matmul)
    if devices_for(seeds) == 1:
        return jax.jit(mapped, **options)
    replicated = NamedSharding(sharding.mesh, PartitionSpec())
    in_shardings = tuple(replicated if axis is None else sharding for axis in in_axes)
    sharded = jax.shard_map(
        mapped,
        mesh=sharding.mesh,
        in_specs=tuple(argument.spec for argument in in_shardings),
        out_specs=sharding.spec,
        check_vma=False,  # not supported for the native engine's callbacks
    )
    return jax.jit(sharded, in_shardings=in_shardings, out_shardings=sharding, **options)
