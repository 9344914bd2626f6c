"""Shared by all tests: the machine's caches stay out of them, and small things to train."""

from __future__ import annotations

import gc
import resource
import shutil
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import jax
import pytest

from ear_jax.config import Config
from ear_jax.runs import loop
from ear_jax.runs.loop import train_run
from experiments import inventory
from tests.helpers.runs import _compile_once, finished_config, tiny_config


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


@pytest.fixture
def run_directory(tmp_path: Path) -> Path:
    return tmp_path / "run"


@pytest.fixture
def compiled_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs of one configuration share one compiled program, which is most of what a small run costs."""
    monkeypatch.setattr(loop, "compile_program", _compile_once)


@pytest.fixture(scope="session")
def finished_once(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that was trained once for all tests, which none may change."""
    directory = tmp_path_factory.mktemp("finished") / "run"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(loop, "compile_program", _compile_once)
        train_run(finished_config(), directory)
    return directory


@pytest.fixture
def finished(finished_once: Path, tmp_path: Path) -> Path:
    """A copy of it."""
    return Path(shutil.copytree(finished_once, tmp_path / "finished"))


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
