"""How this process runs JAX: compiler options, a private compilation cache, and what memory there is."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import jax


def cache_dir() -> Path:
    """Where compiled programs are kept between runs. XLA trusts what it finds there, so it is the user's alone."""
    base = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(os.environ.get("EAR_JAX_CACHE") or Path(base) / "ear_jax") / "xla"


def enable_cache() -> None:
    """Turns JAX's persistent compilation cache on unless the user has set one; does without where it cannot be."""
    if getattr(jax.config, "jax_compilation_cache_dir", None):
        return
    directory = cache_dir()
    try:
        directory.mkdir(parents=True, exist_ok=True, mode=0o700)
        directory.chmod(0o700)
        if directory.stat().st_uid != os.getuid():
            return
    except OSError:
        return
    jax.config.update("jax_compilation_cache_dir", str(directory))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)


def compiler_options(matmul: str = "float32") -> dict[str, Any]:
    """Options for every compiled program of ours.

    On the CPU the time goes to matmuls and to MuJoCo, which LLVM does not touch: optimising less compiles the training
    step 1.5 to 2 times faster, and it runs as fast. YNNPACK makes use of AMX, so where there is that it has the single
    matmuls of what learns in bfloat16. With float32 it is up to a seventh slower at that, and its fusions of matmuls
    with what follows them cost more than they save: with jaxlib 0.10.2 an update under `vmap` takes 1.4 times as long
    with them, with 0.12 the same.

    Args:
      matmul: what most of the program's matmuls multiply, as in `network.matmul`.
    """
    if jax.default_backend() != "cpu":
        return {}
    fused = "LIBRARY_FUSION_TYPE_INDIVIDUAL_DOT" if matmul == "bfloat16" and has_amx() else ""
    return {"xla_backend_optimization_level": 1, "xla_cpu_experimental_ynn_fusion_type": fused}


def has_amx() -> bool:
    """Whether the processor multiplies bfloat16 matrices by an instruction of its own (Linux tells; no: not known)."""
    try:
        return "amx_bf16" in Path("/proc/cpuinfo").read_text().split()
    except OSError:
        return False


def tree_bytes(tree: Any) -> int:
    """The size of a pytree of arrays or of their shapes."""
    return sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(tree))


def available_bytes(devices: int = 1) -> int | None:
    """Memory that arrays can take on so many of JAX's devices together, or None where it cannot be told."""
    stats = [device.memory_stats() for device in jax.local_devices()[:devices]]
    if all(one and "bytes_limit" in one for one in stats):
        return devices * min(one["bytes_limit"] - one.get("bytes_in_use", 0) for one in stats)
    try:
        lines = Path("/proc/meminfo").read_text().splitlines()
    except OSError:
        return None
    kib = next((line.split()[1] for line in lines if line.startswith("MemAvailable:")), None)
    return None if kib is None else int(kib) * 1024
