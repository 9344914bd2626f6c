"""Shared by all tests: the machine's caches stay out of them, and small things to train."""

from __future__ import annotations

import dataclasses
import functools
import gc
import resource
import shutil
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import jax
import pytest

from ear_jax import run
from ear_jax.config import CheckpointConfig, Config, flat
from ear_jax.presets import preset_config
from ear_jax.run import compile_program, train_run
from ear_jax.train import Program, make_program, seed_keys
from experiments import inventory


@pytest.fixture(autouse=True, scope="session")
def _compiling(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Compiled programs are shared between the tests of a session, and with nothing else.

    What tests themselves ask of JAX runs once or twice, so XLA spends no time on making that fast. Programs of the
    package keep the level that they ask for (`runtime.compiler_options`), without LLVM's most expensive passes; those
    that tests start in a process of their own are compiled as a user's.
    """
    jax.config.update("jax_disable_most_optimizations", True)
    jax.config.update("jax_compilation_cache_dir", str(tmp_path_factory.mktemp("xla")))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working directory with no records yet; those made there are all that experiments know of."""
    monkeypatch.setattr(inventory, "RECORDS", tmp_path / "records")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def tiny() -> Config:
    """Trains in a second: two speeds, narrow networks, few updates."""
    return tiny_config()


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


@pytest.fixture
def run_directory(tmp_path: Path) -> Path:
    return tmp_path / "run"


def finished_config(**changes: object) -> Config:
    """Of the finished run below: two seeds, 12 blocks of 2 epochs, checkpoints of epochs 6, 12, 18 and 24."""
    return tiny_config(**{"seeds": 2, "epochs": 24, "checkpoint": CheckpointConfig(blocks=3), **changes})


@pytest.fixture
def compiled_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs of one configuration share one compiled program, which is most of what a small run costs."""
    monkeypatch.setattr(run, "compile_program", _compile_once)


def compiled(config: Config) -> run.Compiled:
    """The compiled program of a configuration; of those that differ only in how long to train, the same."""
    return _compiled(dataclasses.replace(config, epochs=1, minutes=None, checkpoint=CheckpointConfig()))


@functools.cache
def _compiled(config: Config) -> run.Compiled:
    return compile_program(make_program(config), seed_keys(config))


def _compile_once(program: Program, keys: jax.Array) -> run.Compiled:
    return compiled(program.config)


@pytest.fixture(scope="session")
def finished_once(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that was trained once for all tests, which none may change."""
    directory = tmp_path_factory.mktemp("finished") / "run"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run, "compile_program", _compile_once)
        train_run(finished_config(), directory)
    return directory


@pytest.fixture
def finished(finished_once: Path, tmp_path: Path) -> Path:
    """A copy of it."""
    return Path(shutil.copytree(finished_once, tmp_path / "finished"))


def words(config: Config) -> list[str]:
    """The command line of a configuration, every setting named."""
    given = {name: value for name, value in flat(config).items() if value is not None and name != "family"}
    found = ["train", config.family]
    for name, value in given.items():
        found += [f"--{name.replace('_', '-')}", *map(str, value if isinstance(value, tuple) else (value,))]
    return found


# Where a write fails, Orbax leaves others behind that nobody waits for, and Python tells of them when it finds them.
stray_writes = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")


@pytest.fixture
def small_files() -> Iterator[Callable[[int], AbstractContextManager[None]]]:
    """While entered, no file may grow beyond so many bytes, as on a disk that is full; goes with `stray_writes`."""

    @contextmanager
    def limited(size: int) -> Iterator[None]:
        before = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
        try:
            yield
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)

    yield limited
    gc.collect()  # so that they are found here, and not in another test
