"""Wall time of an epoch a trial: trials of a sweep side by side against one run alone."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from benchmarks import common
from benchmarks.chunk import repeat
from benchmarks.update import filled
from ear_jax.cli.exits import exit_code
from ear_jax.config import Config
from ear_jax.presets import preset_config
from ear_jax.runs import training
from ear_jax.runs.compiled import compile_program, train_epochs
from ear_jax.runs.side_by_side import differing, members

TRIALS = (1, 2, 8)


def contender(config: Config, trials: int) -> Callable[[], None]:
    """Returns a call that trains trials of different step sizes for an epoch."""
    configs = [
        dataclasses.replace(config, sac=dataclasses.replace(config.sac, lr=config.sac.lr * 0.9**index))
        for index in range(trials)
    ]
    program = training.make_program(members(configs))
    keys = jnp.concatenate([training.seed_keys(each) for each in configs])
    compiled = compile_program(program, keys, differing(configs))
    state = jax.jit(jax.vmap(partial(filled, program)))(keys)
    return repeat(lambda state: train_epochs(compiled, state, 1)[0], state)


def main() -> None:
    options = common.arguments(__doc__)
    repeats = 1 if options.quick else 5
    for preset in ("smoke",) if options.quick else ("smoke", "fast"):
        config = preset_config("halfcheetah-vel", preset)
        updates = 2 if options.quick else config.sac.updates // 4
        config = dataclasses.replace(config, sac=dataclasses.replace(config.sac, updates=updates))
        timings = common.alternate({str(count): contender(config, count) for count in TRIALS}, repeats)
        row: dict[str, Any] = {"preset": preset, "backend": jax.default_backend(), "updates": updates}
        for count in TRIALS:
            row.update(common.spread(f"seconds_{count}", timings[str(count)].seconds))
        for count in TRIALS[1:]:
            a_trial = [seconds / count for seconds in timings[str(count)].seconds]
            row.update(common.spread(f"a_trial_of_{count}_to_one_alone", common.ratios(a_trial, timings["1"].seconds)))
        common.write_row(options, "sweep", row)


if __name__ == "__main__":
    sys.exit(exit_code("sweep", main))
