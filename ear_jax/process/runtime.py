"""JAX in this process: compiler options, a private compilation cache and the memory available."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import jax

from ear_jax.files.replacing import replace_file
from ear_jax.process.target import on_accelerator


def cache_dir(name: str = "xla") -> Path | None:
    """Returns a directory of the user's cache, by default that of compiled programs, or None.

    XLA trusts the contents of that one, so only the user may write there. None if no variable names a cache and the
    user has no home.
    """
    named = os.environ.get("EAR_JAX_CACHE")
    base = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    if not named and base.startswith("~"):
        return None
    return Path(named or Path(base) / "ear_jax") / name


def enable_cache() -> None:
    """Turns on JAX's persistent compilation cache, unless the user set one or the directory cannot be used."""
    if getattr(jax.config, "jax_compilation_cache_dir", None):
        return
    directory = cache_dir()
    if directory is None:
        return
    try:
        directory.mkdir(parents=True, exist_ok=True, mode=0o700)
        directory.chmod(0o700)
        if directory.stat().st_uid != os.getuid():
            return
    except OSError:
        return
    jax.config.update("jax_compilation_cache_dir", str(directory))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)
    # XLA's own caches would put their path into the key of every program, so that a cache that is carried elsewhere
    # would be of no use. The choices they keep are in the programs too.
    jax.config.update("jax_persistent_cache_enable_xla_caches", "none")
    replace_entries_whole()


def replace_entries_whole() -> None:
    """Makes JAX write an entry of its cache as all files here are written.

    JAX writes in place and never again, so a process that is killed then, or read by another, would leave half an
    entry: a warning and a compilation at every start.
    """
    from jax._src.lru_cache import _CACHE_SUFFIX, LRUCache  # JAX has no public name for it

    def put(cache: LRUCache, key: str, value: bytes) -> None:
        with replace_file(Path(cache.path) / f"{key}{_CACHE_SUFFIX}") as scratch:
            scratch.write_bytes(value)

    LRUCache.put = put  # type: ignore[assignment, method-assign]


def compiler_options(matmul: str = "float32") -> dict[str, Any]:
    """Returns the compiler options of a program.

    On the CPU most time goes to matmuls and MuJoCo, which LLVM does not optimise. A lower optimisation level compiles
    the training step 1.5 to 2 times faster and runs as fast. YNNPACK uses the processor's instructions for bfloat16, so
    it gets the single bfloat16 matmuls where there are any. For float32 it is up to a seventh slower. Its fusions of a
    matmul with later operations cost more than they save: an update under `vmap` takes 1.4 times as long (jaxlib 0.10.2
    and 0.12).

    Args:
      matmul: the precision of most of the program's matmuls, as in `network.matmul`.
    """
    if on_accelerator():
        return {}
    fusion = "LIBRARY_FUSION_TYPE_INDIVIDUAL_DOT" if matmul == "bfloat16" and bfloat16_instructions() else ""
    return {"xla_backend_optimization_level": 1, "xla_cpu_experimental_ynn_fusion_type": fusion}


def bfloat16_instructions() -> list[str]:
    """Returns the processor's instructions that multiply bfloat16, by Linux's names; known on Linux only."""
    try:
        flags = Path("/proc/cpuinfo").read_text().split()
    except OSError:
        return []
    return [name for name in ("amx_bf16", "avx512_bf16") if name in flags]


def tree_bytes(tree: Any) -> int:
    """Returns the size in bytes of a pytree of arrays or of their shapes."""
    return sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(tree))
