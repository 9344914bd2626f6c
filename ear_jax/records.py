"""Run directories and what stands in them: the source of every table and figure. Imports no JAX.

A run directory holds `config.json` (settings, tasks, machine, versions, commit), `metrics.jsonl` (a row per seed and
block), the last document of each analysis (`evaluation.json`, `interpolation.json`, `adaptation.json`,
`composition.json`, `map.json`, `lse.json`), `ltes.json` (named LTEs), `checkpoints/`, `figures/` and `videos/`.
"""

from __future__ import annotations

import importlib.metadata
import json
import os
import platform
import subprocess
from pathlib import Path
from typing import Any

from ear_jax.errors import RunError, UsageError

PACKAGES = ("jax", "jaxlib", "mujoco", "mujoco-mjx", "brax", "flax", "optax", "orbax-checkpoint", "numpy", "gymnasium")


def write_json(path: Path, document: Any) -> None:
    """Writes a document whole or not at all."""
    scratch = path.with_name(path.name + ".part")
    scratch.write_text(json.dumps(document, indent=2, allow_nan=False) + "\n")
    os.replace(scratch, path)


def read_run(run: Path) -> dict[str, Any]:
    """A run's `config.json`; raises UsageError where there is no run."""
    path = run / "config.json"
    if not path.is_file():
        raise UsageError(f"{run} is not a run directory: it has no config.json (`ear train` makes one)")
    try:
        document = json.loads(path.read_text())
        if not isinstance(document["config"], dict):
            raise ValueError("'config' is no table of settings")
        return document
    except (ValueError, KeyError, TypeError) as error:
        raise RunError(f"{path} cannot be read: {error}") from None


def append_rows(path: Path, rows: list[dict[str, Any]]) -> None:
    """Appends JSON lines and hands them to the disk."""
    with path.open("a") as file:
        file.writelines(json.dumps(row, allow_nan=False) + "\n" for row in rows)
        file.flush()
        os.fsync(file.fileno())


def read_rows(path: Path) -> list[dict[str, Any]]:
    """All whole rows; a last line torn by a crash is passed over."""
    if not path.exists():
        return []
    rows = []
    for line in path.read_text().splitlines():
        try:
            rows.append(json.loads(line))
        except ValueError:
            continue
    return rows


def keep_rows(path: Path, last_epoch: int) -> list[dict[str, Any]]:
    """Forgets rows past an epoch, which a resumed run will write again; returns the others."""
    if not path.exists():
        return []
    rows = read_rows(path)
    kept = [row for row in rows if row["epoch"] <= last_epoch]
    scratch = path.with_name(path.name + ".part")
    scratch.write_text("".join(json.dumps(row) + "\n" for row in kept))
    os.replace(scratch, path)
    return kept


def provenance() -> dict[str, Any]:
    """What a number has to be read with: machine, versions, commit."""
    return {
        "machine": {
            "processor": _processor(),
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
    """This checkout's commit, marked where files differ from it; None outside a checkout."""
    here = Path(__file__).resolve().parent

    def git(*words: str) -> str:
        done = subprocess.run(["git", "-C", here, *words], capture_output=True, text=True, check=True, timeout=10)
        return done.stdout.strip()

    try:
        return git("rev-parse", "--short=12", "HEAD") + ("+changes" if git("status", "--porcelain", "-uno") else "")
    except (OSError, subprocess.SubprocessError):
        return None


def _processor() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()
