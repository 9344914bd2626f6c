"""Wall time of one checkpoint of a `fast` run with a full replay, compared with the training between checkpoints."""

from __future__ import annotations

import argparse
import sys
import tempfile
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp

from benchmarks import common
from benchmarks.chunk import epoch_run
from benchmarks.update import filled
from ear_jax.cli.exits import exit_code
from ear_jax.presets import preset_config
from ear_jax.runs import checkpoint, training


def measure(options: argparse.Namespace, repeats: int) -> None:
    config = preset_config("halfcheetah-vel", "fast")
    program = training.make_program(config)
    state = jax.block_until_ready(jax.jit(jax.vmap(partial(filled, program)))(training.seed_keys(config)))
    epochs = config.log.epochs * config.checkpoint.blocks
    with tempfile.TemporaryDirectory() as scratch:
        directory = Path(scratch)
        contenders = {
            "save": lambda: checkpoint.save(directory, config.epochs, state, {}),
            "epoch": epoch_run(program, jax.tree.map(jnp.copy, state)),
        }
        timings = common.alternate(contenders, repeats)
        size = sum(path.stat().st_size for path in directory.rglob("*") if path.is_file())
    between = [epochs * seconds for seconds in timings["epoch"].seconds]
    row = {
        "preset": config.preset,
        "megabytes": round(size / 1e6, 1),
        "epochs_between": epochs,
        "repeats": repeats,
        **common.spread("save_seconds", timings["save"].seconds),
        **common.spread("seconds_between", between),
        **common.spread("share", common.ratios(timings["save"].seconds, between)),
    }
    common.write_row(options, "saving", row)


def main() -> None:
    options = common.arguments(__doc__)
    measure(options, 1 if options.quick else 5)


if __name__ == "__main__":
    sys.exit(exit_code("saving", main))
