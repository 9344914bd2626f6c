"""Small runs to train, and their states."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from functools import partial
from pathlib import Path

import jax
import numpy as np
import pytest

from ear_jax.cli.sweep import words_of
from ear_jax.config import CheckpointConfig, Config, flag
from ear_jax.presets import preset_config
from ear_jax.runs import checkpoint, records, training
from ear_jax.runs.compiled import Compiled, compile_program, fill_replay, train_epochs
from ear_jax.runs.leaves import named_leaves
from ear_jax.runs.training import Program, make_program, seed_keys


def tiny_config(**changes: object) -> Config:
    base = preset_config("halfcheetah-vel", "smoke")
    base = dataclasses.replace(
        base,
        engine="native",
        epochs=4,
        tasks=("1", "3"),
        network=dataclasses.replace(base.network, width=16),
        sac=dataclasses.replace(base.sac, batch_size=32, updates=4),
        collect=dataclasses.replace(base.collect, envs=2, steps=5, pretrain_epochs=2),
        replay=dataclasses.replace(base.replay, capacity=400),
        log=dataclasses.replace(base.log, epochs=2, episodes=1),
    )
    return dataclasses.replace(base, **changes)  # type: ignore[arg-type]


def finished_config(**changes: object) -> Config:
    """Configures the `finished` run: two seeds, 12 blocks of 2 epochs, checkpoints of epochs 6, 12, 18 and 24."""
    return tiny_config(**{"seeds": 2, "epochs": 24, "checkpoint": CheckpointConfig(blocks=3), **changes})


def compiled(config: Config, numbers: Mapping[str, np.ndarray] | None = None) -> Compiled:
    """Returns the compiled program of a configuration; seed, length and logs do not change it."""
    log = dataclasses.replace(config.log, tensorboard=False, wandb=False)
    config = dataclasses.replace(config, seed=0, epochs=1, minutes=None, log=log, checkpoint=CheckpointConfig())
    return _compiled(config, tuple((name, tuple(values.tolist())) for name, values in (numbers or {}).items()))


@functools.cache
def _compiled(config: Config, numbers: tuple[tuple[str, tuple[float, ...]], ...]) -> Compiled:
    arrays = {name: np.asarray(values, np.float32) for name, values in numbers}
    return compile_program(make_program(config), seed_keys(config), arrays)


def compile_once(program: Program, keys: jax.Array, numbers: Mapping[str, np.ndarray] | None = None) -> Compiled:
    return compiled(program.config, numbers)


def words(config: Config) -> list[str]:
    """Returns the command line of a configuration, with every setting named."""
    return ["train", *words_of(config)]


def sweep_words(config: Config, setting: str, *values: str) -> list[str]:
    """Returns the command line of a sweep in which a setting has these values, and every other that of `config`."""
    line = words_of(config)
    place = line.index(flag(setting))
    return ["sweep", *line[:place], *line[place + 2 :], "--vary", setting, *values]


# When a write fails, Orbax abandons other writes, and Python reports each when it is collected.
stray_writes = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")


def state_after(config: Config, epochs: int) -> training.TrainState:
    """Returns the state after some epochs of training, without a run directory."""
    program = compiled(config)
    state = fill_replay(program, program.init(seed_keys(config)), config.collect.pretrain_epochs)
    return train_epochs(program, state, epochs)[0]


def leaves(state) -> list[np.ndarray]:
    return [np.asarray(leaf) for leaf in named_leaves(state).values()]


def last_state(run: Path, config, warn=pytest.fail) -> training.TrainState:
    """Returns the state in the newest checkpoint of a run."""
    like = jax.eval_shape(jax.vmap(partial(training.init, make_program(config))), seed_keys(config))
    return checkpoint.restore(checkpoint.newest(run / "checkpoints", warn), like)


def step_arrays(run: Path, epoch: int | None = None) -> dict[str, np.ndarray]:
    """Returns the arrays of a run's newest step by name, or those of the step of an epoch."""
    step = checkpoint.newest(run / "checkpoints", pytest.fail, epoch)
    assert step is not None
    assert epoch in (None, step.epoch)
    like = {name: jax.ShapeDtypeStruct(shape, dtype) for name, (dtype, shape) in step.about["leaves"].items()}
    return jax.device_get(checkpoint.restore(step, like))


def assert_same_run(one: Path, other: Path, config: Config) -> None:
    """Asserts the same last state to the bit, and the same rows but for the clock."""
    for mine, yours in zip(leaves(last_state(one, config)), leaves(last_state(other, config)), strict=True):
        np.testing.assert_array_equal(mine, yours)
    rows, others = (records.read_rows(directory / "metrics.jsonl") for directory in (one, other))
    assert [row | {"seconds": 0} for row in rows] == [row | {"seconds": 0} for row in others]
    seeds, blocks = range(config.seeds), range(config.log.epochs, config.epochs + 1, config.log.epochs)
    assert [(row["epoch"], row["seed"]) for row in rows] == [(epoch, seed) for epoch in blocks for seed in seeds]


def times(directory: Path) -> dict[Path, int]:
    """Returns when each file was changed last, but for the lock, which every reader changes."""
    return {path: path.lstat().st_mtime_ns for path in directory.rglob("*") if path.name != "lock"}
