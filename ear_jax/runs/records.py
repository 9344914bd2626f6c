"""Run directories and what stands in them: the source of every table and figure. Imports no JAX.

A run directory holds `config.json` (settings, tasks, machine, versions, commit), `metrics.jsonl` (a row per seed and
block), the last document of each analysis (`evaluation.json`, `interpolation.json`, `adaptation.json`,
`composition.json`, `map.json`, `lse.json`), `ltes.json` (named LTEs), `checkpoints/`, `figures/`, `videos/`, the `lock`
of the process that trains it, and `failure.json` where its numbers went bad.
"""

from __future__ import annotations

import contextlib
import importlib.metadata
import json
import os
import platform
import subprocess
import sys
from pathlib import Path
from typing import Any

from ear_jax.errors import RunError, UsageError

RESULTS = ("experiments/records", "benchmarks/results")  # where a checkout keeps what it found out
PACKAGES = ("jax", "jaxlib", "mujoco", "mujoco-mjx", "brax", "flax", "optax", "orbax-checkpoint", "numpy", "gymnasium")


def write_json(path: Path, document: Any) -> None:
    """Writes a document whole or not at all; raises RunError where it cannot be written."""
    write_text(path, json.dumps(document, indent=2, allow_nan=False) + "\n")


def write_text(path: Path, text: str) -> None:
    """Beside its place and then into it; a link planted under either name is replaced, not followed.

    Raises:
      RunError: it cannot be written.
    """
    scratch = path.with_name(path.name + ".part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        scratch.unlink(missing_ok=True)
        with scratch.open("x", encoding="utf-8") as file:
            file.write(text)
        os.replace(scratch, path)
    except OSError as error:
        with contextlib.suppress(OSError):
            scratch.unlink(missing_ok=True)
        raise RunError(f"cannot write {path}: {error.strerror}") from None


def folder(path: Path) -> Path:
    """The same path, with a directory there and above it; raises RunError where it cannot be made."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RunError(f"cannot write {path}: {error.strerror}") from None
    return path


def read_run(run: Path) -> dict[str, Any]:
    """A run's `config.json`; raises UsageError where there is no run."""
    path = run / "config.json"
    if not path.is_file():
        makes = "`ear train` makes one, and `ear pretrained` lists agents that ship"
        raise UsageError(f"{run} is not a run directory: it has no config.json ({makes})")
    try:
        document = json.loads(path.read_text())
        if not isinstance(document["config"], dict):
            raise ValueError("'config' is no table of settings")
        return document
    except (ValueError, KeyError, TypeError) as error:
        raise RunError(f"{path} cannot be read: {error}") from None


def append_rows(path: Path, rows: list[dict[str, Any]]) -> None:
    """Appends JSON lines and hands them to the disk; raises RunError where they cannot be written."""
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
    """All whole rows; a last line torn by a crash is passed over."""
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
    """Forgets rows past an epoch, which a resumed run will write again, and a torn one."""
    if path.exists():
        kept = [row for row in read_rows(path) if row["epoch"] <= last_epoch]
        write_text(path, "".join(json.dumps(row) + "\n" for row in kept))


def provenance() -> dict[str, Any]:
    """What a number has to be read with: machine, versions, commit."""
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
    """Installed versions of the packages that results depend on; None where one is missing."""

    def version(package: str) -> str | None:
        try:
            return importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            return None

    return {package: version(package) for package in PACKAGES}


def commit() -> str | None:
    """This checkout's commit, marked where its files differ, results left aside; None outside a checkout."""
    here = Path(__file__).resolve().parent

    def git(*words: str) -> str:
        done = subprocess.run(["git", "-C", here, *words], capture_output=True, text=True, check=True, timeout=10)
        return done.stdout.strip()

    try:
        changed = git("status", "--porcelain", "-uno", "--", ":/", *(f":(top,exclude){place}" for place in RESULTS))
        return git("rev-parse", "--short=12", "HEAD") + ("+changes" if changed else "")
    except (OSError, subprocess.SubprocessError):
        return None


def _accelerator() -> str | None:
    """What JAX runs on, where it is no CPU; whoever has not imported JAX has used none."""
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
