"""Wall time of a gradient update with bfloat16 matmuls, compared with float32.

`times_faster` is the median ratio of paired runs. It depends on the processor's instructions for bfloat16.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
from functools import partial
from typing import Literal

import jax

from benchmarks import common
from benchmarks.update import filled, update_run
from ear_jax.cli.exits import exit_code
from ear_jax.config import Config
from ear_jax.presets import preset_config
from ear_jax.process import runtime
from ear_jax.runs import training


def with_matmul(config: Config, matmul: Literal["float32", "bfloat16"]) -> Config:
    return dataclasses.replace(config, network=dataclasses.replace(config.network, matmul=matmul))


def measure(options: argparse.Namespace, width: int, updates: int, repeats: int) -> None:
    config = preset_config("ant-dir", "fast")
    config = dataclasses.replace(config, network=dataclasses.replace(config.network, width=width))
    plain, rounded = (training.make_program(with_matmul(config, matmul)) for matmul in ("float32", "bfloat16"))
    state = jax.jit(jax.vmap(partial(filled, plain)))(training.seed_keys(config))
    contenders = {
        "float32": update_run(plain, state, updates),
        "bfloat16": update_run(rounded, state, updates),
    }
    timings = common.alternate(contenders, repeats)
    row = {
        "family": config.family,
        "preset": config.preset,
        "backend": jax.default_backend(),
        "width": width,
        "batch_size": config.sac.batch_size,
        "updates": updates,
        "repeats": repeats,
        "bfloat16_instructions": runtime.bfloat16_instructions(),
    }
    for name, timing in timings.items():
        row |= common.spread(f"{name}_ms", [1e3 * value / updates for value in timing.seconds])
    row |= common.spread("times_faster", common.ratios(timings["float32"].seconds, timings["bfloat16"].seconds))
    common.write_row(options, "matmul", row)


def main() -> None:
    options = common.arguments(__doc__)
    for width in (256, 512, 1024):
        measure(options, width, *((1, 1) if options.quick else (20, 7)))


if __name__ == "__main__":
    sys.exit(exit_code("matmul", main))
