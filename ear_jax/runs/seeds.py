"""One program for many seeds: vmapped on a device, and spread over devices where there are several."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from ear_jax.process.runtime import compiler_options

AXIS = "seeds"


def devices_for(seeds: int) -> int:
    """How many devices share the seeds evenly: the most there are that divide them."""
    return max(count for count in range(1, jax.local_device_count() + 1) if seeds % count == 0)


def seed_sharding(seeds: int) -> NamedSharding:
    """How leaves [seeds, …] lie on the devices."""
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

    Each device runs its own seeds by themselves: none waits for another, and an engine that calls the host is called
    once a device.

    Args:
      function: of one seed; what it returns gets a leading axis [seeds].
      seeds: how many.
      in_axes: for each argument 0, where it has that axis too, or None.
      matmul: what it mostly multiplies, as in `network.matmul`.
      options: more of `jax.jit`'s.
    """
    mapped, sharding = jax.vmap(function, in_axes), seed_sharding(seeds)
    options["compiler_options"] = compiler_options(matmul)
    if devices_for(seeds) == 1:
        return jax.jit(mapped, **options)
    everywhere = NamedSharding(sharding.mesh, PartitionSpec())
    places = tuple(everywhere if axis is None else sharding for axis in in_axes)
    spread_out = jax.shard_map(
        mapped,
        mesh=sharding.mesh,
        in_specs=tuple(place.spec for place in places),
        out_specs=sharding.spec,
        check_vma=False,  # it cannot see through the callbacks of the native engine
    )
    return jax.jit(spread_out, in_shardings=places, out_shardings=sharding, **options)
