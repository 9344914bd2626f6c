"""Checksums of a directory's files, written beside them in the format of `sha256sum`, which can check them too."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

NAME = "SHA256SUMS"


def write(directory: Path) -> None:
    """Writes the manifest of all files below a directory, and hands both to the disk.

    One pass over what was just written costs 0.1 s for 100 MB, most of it SHA-256.
    """
    names = [name for name in _files(directory) if name != NAME]
    with (directory / NAME).open("w") as file:
        file.write(_text({name: _digest(directory / name, to_disk=True) for name in names}))
        file.flush()
        os.fsync(file.fileno())


def fault(directory: Path) -> str | None:
    """The first thing that is not as the manifest says, in words; None for a directory that is whole.

    No name from the manifest is ever opened: only what lies in the directory, and is no link, is read.
    """
    try:
        present = [name for name in _files(directory) if name != NAME]
        written = (directory / NAME).read_text()
        sums = {name: digest for digest, _, name in (line.partition("  ") for line in written.split("\n")[:-1])}
        for name in sorted({*present, *sums}):
            if name not in sums:
                return f"{name} is not in its manifest {NAME}"
            if name not in present:
                return f"{name} is missing"
            if _digest(directory / name) != sums[name]:
                return f"{name} differs from its checksum"
        return None if written == _text(sums) else f"{NAME} is damaged"
    except _NotPlain as error:
        return f"{error} is no plain file"
    except FileNotFoundError as error:
        return f"{Path(error.filename).name} is missing"
    except OSError as error:
        return f"{Path(error.filename).name} cannot be read: {error.strerror}"
    except UnicodeDecodeError:
        return f"{NAME} is damaged"


class _NotPlain(Exception):
    """A link, pipe or device, which could lead out of the directory."""


def _files(directory: Path) -> list[str]:
    """All files below a directory, by their path in it."""
    found = []
    for path in sorted(directory.rglob("*")):
        name = path.relative_to(directory).as_posix()
        if path.is_symlink() or not (path.is_dir() or path.is_file()):
            raise _NotPlain(name)
        if path.is_file():
            found.append(name)
    return found


def _text(sums: dict[str, str]) -> str:
    return "".join(f"{digest}  {name}\n" for name, digest in sums.items())


def _digest(path: Path, to_disk: bool = False) -> str:
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
        if to_disk:
            os.fsync(file.fileno())
    return digest
