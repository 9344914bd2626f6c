"""Programs of the package compiled as fast as possible: most of a test is compiling, and nearly none of it running."""

from __future__ import annotations

import os
import sys
from typing import Any

import jax

from ear_jax.process import runtime

# XLA's older code for fusions compiles a training step in a quarter of the time. XLA reads the variable when it
# compiles its first program, and processes that tests start inherit it. Newer versions end a process that sets it.
FLAGS = "--xla_cpu_use_fusion_emitters=false --xla_cpu_parallel_codegen_split_count=1"
if jax.__version_info__ < (0, 11) and FLAGS not in os.environ.get("XLA_FLAGS", ""):
    os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} {FLAGS}".strip()

_options = runtime.compiler_options


def _quick_options(matmul: str = "float32") -> dict[str, Any]:
    options = _options(matmul)
    return {**options, "xla_backend_optimization_level": 0} if options else options


def compile_quickly() -> None:
    """Leaves out whatever XLA spends on making programs run fast, in all that this process compiles from now on.

    Tests kill processes that share a cache, so its entries are replaced whole.
    """
    runtime.replace_entries_whole()
    jax.config.update("jax_disable_most_optimizations", True)
    for name, module in list(sys.modules.items()):
        if name.startswith("ear_jax.") and getattr(module, "compiler_options", None) is _options:
            module.compiler_options = _quick_options  # type: ignore[attr-defined]


def shared_cache() -> dict[str, str]:
    """Returns the variables that give another process the cache of this one's compiled programs."""
    return {
        "JAX_COMPILATION_CACHE_DIR": str(jax.config.jax_compilation_cache_dir),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": str(jax.config.jax_persistent_cache_min_compile_time_secs),
    }


if __name__ == "__main__":  # `ear` in a process of its own, to the bit as in a test
    from ear_jax.cli.main import main

    compile_quickly()
    sys.exit(main())
