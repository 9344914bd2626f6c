"""Run directories and their documents, the source of every table and figure. Imports no JAX.

A run directory holds `config.json` (settings, tasks, machine, versions, commit), `metrics.jsonl` (a row per seed and
block), the documents of analyses, named by their options (`evaluation.json`, `interpolation.json`, `adaptation.json`,
`composition.json`, `map.json`, `front.json`, `imagination.json`, `following.json`, `lse.json`), `ltes.json` (named
LTEs), `survey….safetensors` and `imagined.safetensors` (of the sphere of LTEs, for later analyses), `checkpoints/`,
`figures/`, `videos/`, the `lock` of the process that trains it, and `failure.json` if a metric was not finite.
"""

from __future__ import annotations

import functools
import importlib.metadata
import os
import platform
import subprocess
import sys
from pathlib import Path
from typing import Any

import ear_jax
from ear_jax import pretrained
from ear_jax.errors import RunError, UsageError
from ear_jax.files.documents import read_json, write_json
from ear_jax.files.replacing import folder, write_text
from ear_jax.files.rows import Keys, append_rows, read_rows

__all__ = ["append_rows", "folder", "read_json", "read_rows", "write_json", "write_text"]  # used as `records.…`

RESULTS = ("experiments/records", "benchmarks/results")  # a checkout's results, whose changes do not mark its commit
# What every row of metrics.jsonl has.
METRICS: Keys = {
    **dict.fromkeys(("seed", "epoch", "env_steps", "updates"), int),
    **dict.fromkeys(("seconds", "mean_return"), (int, float)),
    "returns": dict,
}
PACKAGES = ("jax", "jaxlib", "mujoco", "mujoco-mjx", "brax", "flax", "optax", "orbax-checkpoint", "numpy", "gymnasium")


def read_run(run: Path) -> dict[str, Any]:
    """Returns a run's `config.json`; raises UsageError if there is no run, RunError if it cannot be read."""
    path = run / "config.json"
    if not path.is_file():
        if str(run).startswith(pretrained.PREFIX):
            raise UsageError(f"{run} has no metrics: it ships without its run; name a run directory")
        if str(run) in pretrained.names():
            raise UsageError(f"{run} is not a run directory; did you mean {pretrained.PREFIX}{run}?")
        made = "`ear train` makes one, and `ear pretrained` lists agents that ship"
        raise UsageError(f"{run} is not a run directory: it has no config.json ({made})")
    document = read_json(path)
    if not isinstance(document.get("config"), dict):
        raise RunError(f"{path} cannot be read: 'config' is not a table of settings")
    return document


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
    """Returns the versions of this package and of those that results depend on; None for a missing one."""

    def version(package: str) -> str | None:
        try:
            return importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            return None

    return {"ear_jax": ear_jax.__version__, **{package: version(package) for package in PACKAGES}}


@functools.cache  # a sweep asks for every run
def commit() -> str | None:
    """Returns the checkout's commit, marked `+changes` if files other than results differ; None outside a checkout."""
    here = Path(__file__).resolve()

    def git(*arguments: str) -> str:
        line = ["git", "-C", str(here.parent), *arguments]
        return subprocess.run(line, capture_output=True, text=True, check=True, timeout=10).stdout.strip()

    try:
        git("ls-files", "--error-unmatch", "--", here.name)  # fails where ear_jax lies in another project's checkout
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
