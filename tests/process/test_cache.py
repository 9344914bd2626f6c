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


def compile_in(folder: Path) -> tuple[dict[str, bytes], str]:
    """Compiles in a fresh process; returns the cache's entries by name, and what the process said."""
    environment = {name: value for name, value in os.environ.items() if name != "JAX_COMPILATION_CACHE_DIR"}
    environment["EAR_JAX_CACHE"] = str(folder)
    done = subprocess.run([sys.executable, "-c", COMPILE], env=environment, check=True, capture_output=True, text=True)
    entries = [path for path in (folder / "xla").iterdir() if path.name.endswith("-cache")]
    return {path.name: path.read_bytes() for path in sorted(entries)}, done.stderr


def test_a_cache_that_is_carried_elsewhere_still_serves(tmp_path):
    first, _ = compile_in(tmp_path / "here")
    assert first
    shutil.copytree(tmp_path / "here", tmp_path / "there")
    assert compile_in(tmp_path / "there") == (first, "")


def test_an_entry_that_was_cut_short_is_replaced_by_the_next_process(tmp_path):
    whole, _ = compile_in(tmp_path)
    for name, content in whole.items():
        (tmp_path / "xla" / name).write_bytes(content[: len(content) // 2])
    replaced, said = compile_in(tmp_path)
    assert replaced.keys() == whole.keys()
    assert "Error reading persistent compilation cache entry" in said
    assert compile_in(tmp_path) == (replaced, "")
    assert not [path for path in (tmp_path / "xla").iterdir() if path.name.endswith(".part")]
