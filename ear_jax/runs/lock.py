"""The lock that keeps a run's directory to one process."""

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
    """Another process holds the directory's lock."""


@contextmanager
def lock_directory(directory: Path, announce: Callable[[str], None]) -> Iterator[int]:
    """A context that creates a run's directory and keeps other processes out of it.

    The kernel holds the lock (flock) and releases it however the process ends; the file only names the holder. A name
    left in the file is that of a process that was killed. It is announced and otherwise ignored.

    Yields the lock's descriptor: a process that inherits it keeps the directory, should this one be killed before.

    Args:
      directory: the run's.
      announce: called with a line about a process that was killed.

    Raises:
      InUse: another process holds the lock.
      RunError: the directory or the lock cannot be made.
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
            announce(f"{killed}, which used {directory} before, was killed; ignoring its lock")
        _write_holder(lock, f"process {os.getpid()} on {socket.gethostname()}")
        try:
            yield lock
        finally:
            _write_holder(lock, "")
    finally:
        os.close(lock)


def _take(lock: int, directory: Path) -> None:
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        holder = _holder(lock) or "another process"  # which may not have written its name yet
        raise InUse(f"{directory} is in use by {holder}; wait for it, or name another --out") from None
    except OSError as error:
        raise RunError(f"cannot lock {directory / NAME}: {error.strerror}") from None


def _holder(lock: int) -> str:
    return os.pread(lock, 200, 0).decode(errors="replace").strip()


def _write_holder(lock: int, holder: str) -> None:
    os.ftruncate(lock, 0)
    with contextlib.suppress(OSError):  # on a full disk the lock holds without a name
        os.pwrite(lock, holder.encode(), 0)
