"""Every output file is written here: whole or not at all, and never through a link."""

from __future__ import annotations

import contextlib
import fcntl
import glob
import os
import secrets
from collections.abc import Iterator
from pathlib import Path

from ear_jax.errors import RunError


@contextlib.contextmanager
def replace_file(path: Path) -> Iterator[Path]:
    """A context that yields a new, empty file beside `path`, which replaces `path` once the context ends.

    The new file has a name of its own, so that two processes may write one file: the last one stays. It is flushed to
    disk (fsync) before it gets its name. A link at `path` is replaced and not followed. The directory is made if it is
    missing.

    Raises:
      RunError: the file cannot be written; `path` is unchanged.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _remove_leftovers(path)
        scratch, file = _create_beside(path)
        try:
            yield scratch
            os.fsync(file)
            os.replace(scratch, path)
        finally:
            os.close(file)
            scratch.unlink(missing_ok=True)
    except OSError as error:
        raise RunError(f"cannot write {path}: {error.strerror or error}") from None


@contextlib.contextmanager
def lock_file(path: Path) -> Iterator[None]:
    """A context around reading a file, changing it and writing it, which other processes wait to enter.

    Raises:
      RunError: the lock cannot be taken.
    """
    _, file = _open_lock(path)
    try:
        with contextlib.suppress(OSError):  # some file systems have no locks
            fcntl.flock(file, fcntl.LOCK_EX)
        yield
    finally:
        os.close(file)


@contextlib.contextmanager
def claim_file(path: Path) -> Iterator[None]:
    """A context that no other process enters for the same file meanwhile.

    Raises:
      RunError: another process is in it, or the lock cannot be made.
    """
    lock, file = _claim(path)
    try:
        yield
    finally:
        lock.unlink(missing_ok=True)
        os.close(file)


def _open_lock(path: Path) -> tuple[Path, int]:
    """Opens the file beside `path` that locks it; returns its path and descriptor."""
    lock = path.with_name(f".{path.name}.lock")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        return lock, os.open(lock, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
    except OSError as error:
        raise RunError(f"cannot make {lock}: {error.strerror}") from None


def _claim(path: Path) -> tuple[Path, int]:
    """Makes and locks the file beside `path` that claims it; returns its path and descriptor."""
    while True:
        lock, file = _open_lock(path)
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(file)
            raise RunError(f"another process writes {path}; wait for it, or name another file") from None
        except OSError:  # some file systems have no locks
            return lock, file
        if os.fstat(file).st_nlink:
            return lock, file
        os.close(file)  # its last holder removed it before it was locked


def write_text(path: Path, text: str) -> None:
    """Replaces a UTF-8 file; raises RunError if it cannot be written."""
    with replace_file(path) as scratch:
        scratch.write_text(text, encoding="utf-8")


def copy_file(source: Path, path: Path) -> None:
    """Replaces a file by a copy of another; raises RunError if one cannot be read or the other not written."""
    try:
        content = source.read_bytes()
    except OSError as error:
        raise RunError(f"{source} cannot be read: {error.strerror}") from None
    with replace_file(path) as scratch:
        scratch.write_bytes(content)


def folder(path: Path) -> Path:
    """Creates a directory for outputs and returns it; raises RunError if that fails, or if it is a link."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RunError(f"cannot write {path}: {error.strerror}") from None
    if path.is_symlink():
        raise RunError(f"cannot write in {path}: it is a link to {os.readlink(path)}; nothing is written through links")
    return path


def _create_beside(path: Path) -> tuple[Path, int]:
    """Creates a scratch file and locks it for as long as it is open; returns its path and its descriptor."""
    while True:
        scratch = path.with_name(f".{path.name}.{secrets.token_hex(4)}.part")
        file = os.open(scratch, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)
        with contextlib.suppress(OSError):  # some file systems have no locks
            fcntl.flock(file, fcntl.LOCK_EX)
        if os.fstat(file).st_nlink:
            return scratch, file
        os.close(file)  # another process took it for a leftover before it was locked


def _remove_leftovers(path: Path) -> None:
    """Removes the scratch files of `path` that no process has locked: their writers were killed."""
    for leftover in path.parent.glob(f".{glob.escape(path.name)}.{'[0-9a-f]' * 8}.part"):
        with contextlib.suppress(OSError):
            file = os.open(leftover, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                leftover.unlink()
            finally:
                os.close(file)
