"""Programs of the package compiled as fast as possible: most of a test is compiling, and nearly none of it running."""

from __future__ import annotations

import sys
from typing import Any

import jax

from ear_jax.process import runtime

_options = runtime.compiler_options


def _quick_options(matmul: str = "float32") -> dict[str, Any]:
    options = _options(matmul)
    return {**options, "xla_backend_optimization_level": 0} if options else options


def compile_quickly() -> None:
    """Leaves out whatever XLA spends on making programs run fast, in all that this process compiles from now on."""
    jax.config.update("jax_disable_most_optimizations", True)
    for name, module in list(sys.modules.items()):
        if name.startswith("ear_jax.") and getattr(module, "compiler_options", None) is _options:
            module.compiler_options = _quick_options  # type: ignore[attr-defined]


if __name__ == "__main__":  # `ear` in a process of its own, to the bit as in a test
    from ear_jax.cli.main import main

    compile_quickly()
    sys.exit(main())
