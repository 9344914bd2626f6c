"""`ear doctor`."""

from __future__ import annotations

import ctypes.util
import json
import sys
from dataclasses import dataclass
from typing import Any

from ear_jax.cli.arguments import parse
from ear_jax.errors import RunError
from ear_jax.runs import records


@dataclass(frozen=True)
class DoctorCommand:
    """Check this installation. The exit code is 1 if its versions are known not to work together."""

    json: bool = False
    """Print one JSON document and nothing else."""


def main(words: list[str]) -> None:
    command = parse(DoctorCommand, words, "doctor")
    versions = records.versions()
    problems = known_bad(versions, sys.version_info[:2])
    findings = {**records.provenance(), **({} if problems else _running()), "problems": problems}
    if command.json:
        print(json.dumps(findings))
    else:
        _print(findings)
    if problems:
        raise RunError(f"{len(problems)} problem{'s' * (len(problems) > 1)} found: {'; '.join(problems)}")


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


def _running() -> dict[str, Any]:
    """Returns the findings that need JAX."""
    import jax

    from ear_jax.physics import choose_engine
    from ear_jax.process.runtime import available_bytes, cache_dir, compiler_options, has_amx

    memory = available_bytes()
    return {
        "device": {
            "backend": jax.default_backend(),
            "devices": [str(device.device_kind) for device in jax.local_devices()],
            "free_memory_gb": None if memory is None else round(memory / 1e9, 1),
            "matmul_precision": getattr(jax.config, "jax_default_matmul_precision", None) or "default",
            "amx": has_amx(),
        },
        "engine": choose_engine("auto"),
        "compiler_options": compiler_options(),
        "rendering": next((name for name in ("EGL", "OSMesa") if ctypes.util.find_library(name)), None),
        "compilation_cache": getattr(jax.config, "jax_compilation_cache_dir", None) or str(cache_dir()),
    }


def _print(findings: dict[str, Any], indent: str = "") -> None:
    for name, value in findings.items():
        if isinstance(value, dict):
            print(f"{indent}{name.replace('_', ' ')}:")
            _print(value, indent + "  ")
        elif name == "problems":
            print("problems: " + ("; ".join(value) or "none"))
        elif name == "rendering" and value is None:
            print("rendering: none found; figures work, but pictures of the robot need libegl1 or libosmesa6")
        else:
            shown = ", ".join(map(str, value)) if isinstance(value, list) else "none" if value is None else value
            print(f"{indent}{name.replace('_', ' ')}: {shown}")
