"""One process a run directory."""

from __future__ import annotations

import contextlib
import fcntl
import os
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from ear_jax.errors import RunError

NAME = "lock"


class InUse(RunError):
    """Another process holds the directory."""


@contextmanager
def lock_directory(directory: Path, announce: Callable[[str], None]) -> Iterator[None]:
    """Makes a run's directory, and keeps every other process out of it while entered.

    The lock is the kernel's (flock), which takes it back however the process ends; the file only says whose it is. A
    name left in it is of a process that was killed, and is announced, not obeyed.

    Args:
      directory: the run's.
      announce: told of a process that was killed.

    Raises:
      InUse: another process holds it.
      RunError: it cannot be made.
    """
    try:
        directory.mkdir(parents=True, exist_ok=True)
        lock = os.open(directory / NAME, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o644)
    except OSError as error:
        raise RunError(f"cannot make {error.filename}: {error.strerror}") from None
    try:
        _take(lock, directory)
        killed = _holder(lock)
        if killed:
            announce(f"{killed}, which had {directory} before, was killed; its lock is void")
        _name(lock, f"process {os.getpid()} on {socket.gethostname()}")
        try:
            yield
        finally:
            _name(lock, "")
    finally:
        os.close(lock)


def _take(lock: int, directory: Path) -> None:
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise InUse(f"{directory} is in use by {_holder(lock)}; wait for it, or name another --out") from None
    except OSError as error:
        raise RunError(f"cannot lock {directory / NAME}: {error.strerror}") from None


def _holder(lock: int) -> str:
    return os.pread(lock, 200, 0).decode(errors="replace").strip()


def _name(lock: int, holder: str) -> None:
    os.ftruncate(lock, 0)
    with contextlib.suppress(OSError):  # on a full disk nobody is named, and it is locked all the same
        os.pwrite(lock, holder.encode(), 0)
