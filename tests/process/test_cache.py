"""The compilation cache."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

COMPILE = """
import jax, jax.numpy as jnp
from ear_jax.process.runtime import enable_cache
enable_cache()
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
jax.jit(lambda x: jnp.sin(x) @ x)(jnp.ones((8, 8)))
"""


def test_a_cache_that_is_carried_elsewhere_still_serves(tmp_path):
    def entries(folder: Path) -> list[str]:
        environment = {name: value for name, value in os.environ.items() if name != "JAX_COMPILATION_CACHE_DIR"}
        subprocess.run([sys.executable, "-c", COMPILE], env={**environment, "EAR_JAX_CACHE": str(folder)}, check=True)
        return sorted(path.name for path in (folder / "xla").iterdir() if path.name.endswith("-cache"))

    first = entries(tmp_path / "here")
    assert first
    shutil.copytree(tmp_path / "here", tmp_path / "there")
    assert entries(tmp_path / "there") == first
