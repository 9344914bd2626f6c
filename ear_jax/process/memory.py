"""The memory that this process may still take, and the limit that it would come up against."""

from __future__ import annotations

import resource
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from ear_jax.errors import RunError

PROC, GROUPS = Path("/proc"), Path("/sys/fs/cgroup")
# Files of a control group's limit, use and statistics, and the statistic of what the kernel takes back when needed.
VERSION_1 = ("memory.limit_in_bytes", "memory.usage_in_bytes", "memory.stat", "total_inactive_file")
VERSION_2 = ("memory.max", "memory.current", "memory.stat", "inactive_file")
# Limits of `ulimit`: its option, and the column of /proc/self/statm that counts against it, in pages.
LIMITS = ((resource.RLIMIT_AS, "-v", 0), (resource.RLIMIT_DATA, "-d", 5))
STARTING = 1_550_000_000  # bytes of address space that a command has reserved once JAX has started, as measured


@dataclass(frozen=True)
class Room:
    """Memory that is free under one limit."""

    bytes: int
    limit: str  # in words
    virtual: bool = False  # counts what is reserved, and not only what is used
    of_device: bool = False  # a device's own memory, and not the host's


def available(devices: int = 1) -> list[Room]:
    """Returns the room under each limit that is known: of devices with memory of their own, else of this process.

    Args:
      devices: the number of devices, of the first ones, that are used together.
    """
    import jax

    stats = [device.memory_stats() for device in jax.local_devices()[:devices]]
    if all(memory and "bytes_limit" in memory for memory in stats):
        free = min(memory["bytes_limit"] - memory.get("bytes_in_use", 0) for memory in stats)
        return [Room(devices * free, "the device's memory", of_device=True)]
    return [*_of_machine(), *_of_groups(), *_of_process()]


def check_start() -> None:
    """Raises RunError if a limit of `ulimit` is too low for JAX to start, which then ends without a word."""
    for room in _of_process():
        if room.bytes < STARTING:
            free = f"{max(0, room.bytes) / 1e9:.2f} GB is free under {room.limit}"
            raise RunError(f"JAX reserves {STARTING / 1e9:.2f} GB when it starts, but only {free}; raise that limit")


def _of_machine() -> Iterator[Room]:
    for line in _lines(PROC / "meminfo"):
        if line.startswith("MemAvailable:"):
            yield Room(int(line.split()[1]) * 1024, "the machine's memory")


def _of_groups() -> Iterator[Room]:
    """Yields the room in each control group with a limit, this process's own and those above it."""
    for line in _lines(PROC / "self" / "cgroup"):
        _, controllers, path = line.split(":", 2)
        files, tree = (VERSION_2, GROUPS) if not controllers else (VERSION_1, GROUPS / "memory")
        if controllers and "memory" not in controllers.split(","):
            continue
        for group in (tree / path.lstrip("/"), *(tree / path.lstrip("/")).parents):
            limit, used = _numbers(group / files[0]), _numbers(group / files[1])
            if limit and used:
                back = _numbers(group / files[2]).get(files[3], 0)
                yield Room(limit[""] - used[""] + back, f"the control group's limit of {limit[''] / 1e9:.2f} GB")
            if group == tree:
                break


def _of_process() -> Iterator[Room]:
    pages = [int(word) for line in _lines(PROC / "self" / "statm") for word in line.split()]
    for kind, option, column in LIMITS:
        limit, _ = resource.getrlimit(kind)
        if pages and limit != resource.RLIM_INFINITY:
            free = limit - pages[column] * resource.getpagesize()
            yield Room(free, f"`ulimit {option}` of {limit / 1e9:.2f} GB", virtual=True)


def _numbers(path: Path) -> dict[str, int]:
    """Returns the numbers of a control group's file by name, a single one under an empty name; none for `max`."""
    words = [line.split() for line in _lines(path)]
    return {"".join(name): int(value) for *name, value in words if value.isdecimal()}


def _lines(path: Path) -> list[str]:
    try:
        return path.read_text().splitlines()
    except OSError:
        return []
