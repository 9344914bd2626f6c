"""Comparison of fresh processes that train the same run: do they end with equal bits on the device that JAX finds?

    python -m benchmarks.equal_bits PRESET     # trains a few epochs and prints a hash of all that is learnt

`compare` runs this in processes with a cache of compiled programs of their own, and with one that an earlier process
filled. XLA chooses a GPU's kernels by timing them, unless autotuning is off.
"""

from __future__ import annotations

import argparse
import dataclasses
import hashlib
import os
import subprocess
import sys
import tempfile

from ear_jax.cli.exits import exit_code
from ear_jax.config import Config
from ear_jax.errors import RunError
from ear_jax.presets import preset_config

EPOCHS = 3
FAMILY = "halfcheetah-vel"
NO_AUTOTUNING = "--xla_gpu_autotune_level=0"


def trained_hash(config: Config, epochs: int = EPOCHS) -> str:
    """Trains some epochs and returns a hash of what is learnt: parameters and the optimisers' state."""
    import jax
    import numpy as np

    from ear_jax.runs import training
    from ear_jax.runs.compiled import fill_replay, train_epochs
    from ear_jax.runs.on_host import compiler_of

    program, keys = training.make_program(config), training.seed_keys(config)
    compiled = compiler_of(program)(program, keys)
    state = fill_replay(compiled, compiled.init(keys), 1)
    state, _ = train_epochs(compiled, state, epochs)
    found = hashlib.sha256()
    for leaf in jax.tree.leaves(jax.device_get(state.learner)):
        found.update(np.ascontiguousarray(leaf).tobytes())
    return found.hexdigest()


def hash_of_process(preset: str, cache: str, flags: str = "") -> str:
    """Returns the hash that a fresh process prints.

    Args:
      preset: of the run.
      cache: directory of compiled programs.
      flags: XLA's, beside the user's own.

    Raises:
      RunError: the process failed.
    """
    environment = {**os.environ, "EAR_JAX_CACHE": cache, "XLA_PYTHON_CLIENT_PREALLOCATE": "false"}
    environment["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} {flags}".strip()
    command = [sys.executable, "-m", "benchmarks.equal_bits", preset]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RunError(f"a process ended with {done.returncode}: {' '.join(done.stderr.strip().splitlines()[-1:])}")
    return done.stdout.split()[-1]


def compare(preset: str, flags: str = "") -> dict[str, bool]:
    """Returns whether another process has the first one's bits: with a fresh cache, and with the first one's."""
    with tempfile.TemporaryDirectory() as one, tempfile.TemporaryDirectory() as other:
        first = hash_of_process(preset, one, flags)
        return {
            "equal_with_fresh_caches": hash_of_process(preset, other, flags) == first,
            "equal_with_one_cache": hash_of_process(preset, one, flags) == first,
        }


def main() -> None:
    from ear_jax.process.runtime import enable_cache

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("preset", metavar="PRESET")
    config = preset_config(FAMILY, parser.parse_args().preset)
    enable_cache()
    print(trained_hash(dataclasses.replace(config, engine="native")))


if __name__ == "__main__":
    sys.exit(exit_code("equal_bits", main))
