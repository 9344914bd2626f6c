"""MuJoCo's WebAssembly, from the user's cache or by the user's npm, always checked against a pinned hash."""

from __future__ import annotations

import base64
import hashlib
import io
import shutil
import subprocess
import sys
import tarfile
import tempfile
from dataclasses import dataclass
from pathlib import Path

from ear_jax.errors import RunError
from ear_jax.files.replacing import replace_file
from ear_jax.process.runtime import cache_dir

PACKAGE, VERSION = "@mujoco/mujoco", "3.14.0"
# npm's integrity of the package: SHA-512 of its archive.
INTEGRITY = "WPUYidu4Fx8+uM4hQv80SOA0ifpWGrsNJguKs8JBV8SCTxjKQ2/rqsh880nUH0/Vwa8vuefghvCQkkoed3bkUg=="
SECONDS = 120  # until npm is given up


@dataclass(frozen=True)
class Wasm:
    """MuJoCo for the browser: its JavaScript module and the binary that the module loads."""

    module: bytes
    binary: bytes


def archive_path() -> Path | None:
    """Returns the place of the archive in the user's cache; None if the user has none."""
    folder = cache_dir("npm")
    return folder and folder / f"mujoco-{VERSION}.tgz"


def cached() -> Wasm | None:
    """Returns MuJoCo's WebAssembly if it is in the user's cache and undamaged."""
    path = archive_path()
    try:
        content = path.read_bytes() if path else b""
    except OSError:
        return None
    return _opened(content) if _integrity(content) == INTEGRITY else None


def find() -> Wasm:
    """Returns MuJoCo's WebAssembly from the cache, or fetches it there once.

    Raises:
      RunError: it is not in the cache, and npm is missing, fails or delivers something else. Nothing is then cached.
    """
    found = cached()
    if found is not None:
        return found
    content = _fetched()
    if _integrity(content) != INTEGRITY:
        raise RunError(f"npm delivered another {PACKAGE} {VERSION} than the pinned one: its SHA-512 differs")
    path = archive_path()
    if path:
        with replace_file(path) as scratch:
            scratch.write_bytes(content)
    return _opened(content)


def _fetched() -> bytes:
    npm = shutil.which("npm")
    if npm is None:
        raise RunError(f"npm, which fetches MuJoCo's WebAssembly ({PACKAGE} {VERSION}), is not installed")
    with tempfile.TemporaryDirectory() as scratch:
        words = [npm, "pack", f"{PACKAGE}@{VERSION}", "--ignore-scripts", "--fetch-retries=0", "--silent"]
        try:
            done = subprocess.run(
                [*words, "--pack-destination", scratch], cwd=scratch, capture_output=True, text=True, timeout=SECONDS
            )
        except (OSError, subprocess.TimeoutExpired):
            raise RunError(f"npm gave no answer in {SECONDS} seconds; it fetches {PACKAGE} {VERSION} once") from None
        archives = list(Path(scratch).glob("*.tgz"))
        if done.returncode or len(archives) != 1:
            reason = next(iter(done.stderr.strip().splitlines()), "no network?")
            raise RunError(f"npm could not fetch {PACKAGE} {VERSION} ({reason})")
        return archives[0].read_bytes()


def _integrity(content: bytes) -> str:
    return base64.b64encode(hashlib.sha512(content).digest()).decode()


def _opened(content: bytes) -> Wasm:
    with tarfile.open(fileobj=io.BytesIO(content)) as archive:
        return Wasm(*(archive.extractfile(f"package/mujoco.{ending}").read() for ending in ("js", "wasm")))  # type: ignore[union-attr]


if __name__ == "__main__":  # fetches it ahead of the first page, as for tests
    try:
        find()
    except RunError as error:
        sys.exit(str(error))
