"""`ear doctor`."""

from __future__ import annotations

import ctypes.util
import importlib.util
import json
import shutil
import sys
from dataclasses import dataclass
from typing import Any

from ear_jax.cli.arguments import parse
from ear_jax.errors import RunError, counted
from ear_jax.process import environment
from ear_jax.process.terminal import sign_of_life
from ear_jax.runs import records


@dataclass(frozen=True)
class DoctorCommand:
    """Check this installation and its environment variables. The exit code is 1 if they do not work together.

    Example: ear doctor --json
    """

    json: bool = False
    """Print one JSON document and nothing else."""


def main(words: list[str]) -> None:
    command = parse(DoctorCommand, words, "doctor")
    versions = records.versions()
    findings = records.provenance()
    problems = known_bad(versions, sys.version_info[:2])
    with sign_of_life("starting JAX and MuJoCo"):
        problems = problems or environment.problems()
        findings |= {} if problems else _running()
    findings |= {"lacking": lacking(), "problems": problems}
    if command.json:
        print(json.dumps(findings))
    else:
        _print(findings)
    if problems:
        raise RunError(f"{counted(len(problems), 'problem')} found: {'; '.join(problems)}")


def known_bad(versions: dict[str, str | None], python: tuple[int, int]) -> list[str]:
    """Lists the problems of a set of installed versions, one line each.

    Args:
      versions: package → version, or None if it is missing.
      python: major and minor version.
    """
    problems = [f"{package} is not installed" for package, version in versions.items() if version is None]
    if not (3, 11) <= python < (3, 14):
        problems.append(f"Python {python[0]}.{python[1]} is not supported; use 3.11, 3.12 or 3.13")
    pairs = (("mujoco", "mujoco-mjx", 3), ("jax", "jaxlib", 2))  # with the number of version parts that must agree
    for first, second, numbers in pairs:
        one, other = versions.get(first), versions.get(second)
        if one and other and one.split(".")[:numbers] != other.split(".")[:numbers]:
            problems.append(f"{first} {one} and {second} {other} do not match; install the same version of both")
    jax_version = versions.get("jax")
    if jax_version and not (0, 10) <= tuple(int(part) for part in jax_version.split(".")[:2]) < (0, 13):
        problems.append(f"jax {jax_version} is untested; 0.10, 0.11 and 0.12 work")
    return problems


def lacking() -> list[str]:
    """Lists what is not installed although commands can use it, and what they do without."""
    found = []
    if not shutil.which("ffmpeg"):
        found.append("ffmpeg is not on the PATH, so `ear render` makes GIFs and no MP4s")
    if _opengl() is None:
        found.append("no OpenGL, so there are figures but no pictures of the robot; install libegl1 or libosmesa6")
    if not importlib.util.find_spec("metaworld"):
        found.append("no metaworld, so the family reach cannot be built; pip install 'ear-jax[reach]'")
    return found


def _opengl() -> str | None:
    """Returns the library that draws off screen; None if there is none."""
    return next((name for name in ("EGL", "OSMesa") if ctypes.util.find_library(name)), None)


def _running() -> dict[str, Any]:
    """Returns the findings that need JAX."""
    import jax

    from ear_jax.physics import choose_engine
    from ear_jax.process.memory import available
    from ear_jax.process.precision import numbers
    from ear_jax.process.runtime import bfloat16_instructions, cache_dir, compiler_options

    rooms = available()
    return {
        "device": {
            "backend": jax.default_backend(),
            "devices": [str(device.device_kind) for device in jax.local_devices()],
            "free_memory_gb": round(min(room.bytes for room in rooms) / 1e9, 1) if rooms else None,
            "matmul_precision": getattr(jax.config, "jax_default_matmul_precision", None) or "default",
            "bfloat16_instructions": bfloat16_instructions(),
        },
        "arithmetic": numbers(),
        "engine": choose_engine("auto"),
        "compiler_options": compiler_options(),
        "rendering": _opengl(),
        "compilation_cache": getattr(jax.config, "jax_compilation_cache_dir", None) or str(cache_dir() or "none"),
    }


def _print(findings: dict[str, Any], indent: str = "") -> None:
    for name, value in findings.items():
        if isinstance(value, dict):
            print(f"{indent}{name.replace('_', ' ')}:")
            _print(value, indent + "  ")
        elif name in ("lacking", "problems"):
            print(f"{name}: " + ("; ".join(value) or "none"))
        else:
            shown = ", ".join(map(str, value)) if isinstance(value, list) else value
            print(f"{indent}{name.replace('_', ' ')}: {'none' if shown in (None, '') else shown}")
