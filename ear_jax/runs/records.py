"""Run directories and their documents, the source of every table and figure. Imports no JAX.

A run directory holds `config.json` (settings, tasks, machine, versions, commit), `metrics.jsonl` (a row per seed and
block), the last document of each analysis (`evaluation.json`, `interpolation.json`, `adaptation.json`,
`composition.json`, `map.json`, `lse.json`), `ltes.json` (named LTEs), `checkpoints/`, `figures/`, `videos/`, the `lock`
of the process that trains it, and `failure.json` if a metric was not finite.
"""

from __future__ import annotations

import contextlib
import importlib.metadata
import json
import os
import platform
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

from ear_jax.errors import RunError, UsageError

RESULTS = ("experiments/records", "benchmarks/results")  # a checkout's results, whose changes do not mark its commit
PACKAGES = ("jax", "jaxlib", "mujoco", "mujoco-mjx", "brax", "flax", "optax", "orbax-checkpoint", "numpy", "gymnasium")


def write_json(path: Path, document: Any) -> None:
    """Writes a JSON document atomically; raises RunError if it cannot be written."""
    write_text(path, json.dumps(document, indent=2, allow_nan=False) + "\n")


def write_text(path: Path, text: str) -> None:
    """Writes a file atomically and creates its directory; raises RunError if it cannot be written."""
    folder(path.parent)
    with replacing(path, "x") as file:
        file.write(text)


@contextlib.contextmanager
def replacing(path: Path, mode: str) -> Iterator[IO[Any]]:
    """Opens a temporary file that replaces `path` once it is written; links at either name are not followed.

    Args:
      path: the file to replace.
      mode: `x` for UTF-8 text, `xb` for bytes.

    Raises:
      RunError: the file cannot be written; `path` is unchanged.
    """
    scratch = path.with_name(path.name + ".part")
    try:
        scratch.unlink(missing_ok=True)
        with scratch.open(mode, encoding=None if "b" in mode else "utf-8") as file:
            yield file
        os.replace(scratch, path)
    except OSError as error:
        with contextlib.suppress(OSError):
            scratch.unlink(missing_ok=True)
        raise RunError(f"cannot write {path}: {error.strerror}") from None


def folder(path: Path) -> Path:
    """Creates a directory and its parents and returns it; raises RunError if that fails."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RunError(f"cannot write {path}: {error.strerror}") from None
    return path


def read_run(run: Path) -> dict[str, Any]:
    """Returns a run's `config.json`; raises UsageError if there is no run, RunError if it cannot be read."""
    path = run / "config.json"
    if not path.is_file():
        hint = "`ear train` makes one, and `ear pretrained` lists agents that ship"
        raise UsageError(f"{run} is not a run directory: it has no config.json ({hint})")
    try:
        document = json.loads(path.read_text())
        if not isinstance(document["config"], dict):
            raise ValueError("'config' is not a table of settings")
        return document
    except (ValueError, KeyError, TypeError) as error:
        raise RunError(f"{path} cannot be read: {error}") from None


def append_rows(path: Path, rows: list[dict[str, Any]]) -> None:
    """Appends JSON lines and flushes them to disk (fsync); raises RunError if they cannot be written."""
    lines = "".join(json.dumps(row, allow_nan=False) + "\n" for row in rows)
    try:
        file = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_NOFOLLOW, 0o644)
        with os.fdopen(file, "w") as stream:
            stream.write(lines)
            stream.flush()
            os.fsync(file)
    except OSError as error:
        raise RunError(f"cannot write {path}: {error.strerror}") from None


def read_rows(path: Path) -> list[dict[str, Any]]:
    """Returns all complete rows; lines cut off by a crash are skipped."""
    if not path.exists():
        return []
    rows = []
    for line in path.read_text(errors="replace").splitlines():
        try:
            rows.append(json.loads(line))
        except ValueError:
            continue
    return rows


def keep_rows(path: Path, last_epoch: int) -> None:
    """Removes rows past an epoch, which a continued run writes again, and incomplete lines."""
    if path.exists():
        kept = [row for row in read_rows(path) if row["epoch"] <= last_epoch]
        write_text(path, "".join(json.dumps(row) + "\n" for row in kept))


def provenance() -> dict[str, Any]:
    """Returns the provenance of results: machine, versions and commit."""
    return {
        "machine": {
            "processor": _processor(),
            **({"accelerator": name} if (name := _accelerator()) else {}),
            "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
            "system": f"{platform.system()} {platform.machine()}",
            "python": platform.python_version(),
        },
        "versions": versions(),
        "commit": commit(),
    }


def versions() -> dict[str, str | None]:
    """Returns the installed versions of the packages that results depend on; None for a missing one."""

    def version(package: str) -> str | None:
        try:
            return importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            return None

    return {package: version(package) for package in PACKAGES}


def commit() -> str | None:
    """Returns the checkout's commit, marked `+changes` if files other than results differ; None outside a checkout."""
    here = Path(__file__).resolve().parent

    def git(*arguments: str) -> str:
        result = subprocess.run(["git", "-C", here, *arguments], capture_output=True, text=True, check=True, timeout=10)
        return result.stdout.strip()

    try:
        changed = git("status", "--porcelain", "-uno", "--", ":/", *(f":(top,exclude){place}" for place in RESULTS))
        return git("rev-parse", "--short=12", "HEAD") + ("+changes" if changed else "")
    except (OSError, subprocess.SubprocessError):
        return None


def _accelerator() -> str | None:
    """Returns the accelerator that JAX runs on; None for a CPU, or if JAX was never imported."""
    jax = sys.modules.get("jax")
    if jax is None or jax.default_backend() == "cpu":
        return None
    return jax.local_devices()[0].device_kind


def _processor() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()
