"""Faults of a computer: a process killed at any change of the file system, and bits that flip."""

from __future__ import annotations

import contextlib
import itertools
import os
import random
import sys
from collections.abc import Callable, Iterator

CHANGES = {"os.rename", "os.remove", "os.rmdir", "os.mkdir", "os.link", "os.symlink", "os.truncate"}
_seen: list[int] = []  # changes so far, while they are counted
_last: list[int] = []  # the change before which the process is killed


class Killed(BaseException):
    """Stands for a kill: from then on nothing on disk changes, whatever handlers and cleanups run."""


def _watch(event: str, arguments: tuple) -> None:
    if not _seen or not (event in CHANGES or (event == "open" and _writes(arguments))):
        return
    _seen[0] += 1
    if _last and _seen[0] >= _last[0]:
        raise Killed


def _writes(arguments: tuple) -> bool:
    path, _, flags = arguments
    return isinstance(path, str | bytes | os.PathLike) and bool((flags or 0) & (os.O_WRONLY | os.O_RDWR | os.O_CREAT))


sys.addaudithook(_watch)  # a hook stays for the life of the process; this one is idle unless it counts


@contextlib.contextmanager
def killed_before(change: int) -> Iterator[list[bool]]:
    """A context that is killed before its n-th change of the file system, from 1.

    Yields an empty list, to which True is added if the context comes to its end.
    """
    _seen[:], _last[:] = [0], [change]
    survived: list[bool] = []
    try:
        with contextlib.suppress(Killed):
            yield survived
            survived.append(True)
    finally:
        _seen.clear()
        _last.clear()


def each_kill(prepare: Callable[[], object], act: Callable[[], object]) -> Iterator[int]:
    """Yields after each run of `act` that was killed: before its first change, its second and so on to its last."""
    for change in itertools.count(1):
        prepare()
        with killed_before(change) as survived:
            act()
        if survived:
            assert change > 2, "it changes nothing"
            return
        yield change


def flips(content: bytes, count: int, seed: int = 0) -> Iterator[bytes]:
    """Yields copies of some bytes with one bit flipped each: all of them if `count` is as large as their number."""
    dice = random.Random(seed)
    places = range(8 * len(content))
    for place in dice.sample(places, min(count, len(places))):
        flipped = bytearray(content)
        flipped[place // 8] ^= 1 << place % 8
        yield bytes(flipped)
