"""Fixtures of all tests, which use none of the machine's caches, and the order in which they run."""

from __future__ import annotations

import gc
import os
import resource
import shutil
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

import jax
import pytest
from xdist.scheduler import LoadScopeScheduling

from ear_jax.config import Config
from ear_jax.errors import RunError, UsageError
from ear_jax.runs import on_host
from ear_jax.runs.loop import train_run
from experiments import inventory
from tests.helpers.quick import compile_quickly
from tests.helpers.runs import compile_once, finished_config, times, tiny_config

# Files whose tests share what is compiled or trained, so that one process runs them all; each other file is a group of
# its own. The groups that take longest come first, so that `--numprocesses 2` ends in both processes at about the same
# time.
GROUPS = (
    ("bandit", ("methods", "learning", "agents", "house/test_walkthrough")),
    ("run", ("runs", "rendering", "experiments/test_keeping", "cli/test_asking", "cli/test_config", "cli/test_places")),
    *((file, (file,)) for file in ("cli/test_cli", "envs/test_families", "embeddings/test_embeddings")),
)


def group_of(file: str) -> tuple[int, str]:
    """Returns the rank and the name of the group of a file, such as `learning/test_sac`; of the others, their own."""
    for rank, (name, places) in enumerate(GROUPS):
        if file.startswith(places):
            return rank, name
    return len(GROUPS), file


def file_of(nodeid: str) -> str:
    """Returns the file of a test's identifier, `tests/learning/test_sac.py::test_…`, without folder and ending."""
    return nodeid.partition("::")[0].removeprefix("tests/").removesuffix(".py")


class GroupScheduling(LoadScopeScheduling):
    """Gives each process whole groups of tests."""

    def _split_scope(self, nodeid: str) -> str:
        return group_of(file_of(nodeid))[1]


def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> GroupScheduling:
    return GroupScheduling(config, log)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Puts the long groups first."""
    items.sort(key=lambda item: group_of(file_of(item.nodeid))[0])


@pytest.fixture(autouse=True, scope="session")
def _compiling(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Compiled programs are shared between the processes of the tests; EAR_JAX_TEST_CACHE keeps them for later ones.

    What they compute runs once or twice, so XLA spends no time on making it fast. Processes that tests start compile
    nearly as a user's do, but for those started as `tests.helpers.quick`, and `ear train` in tests/cli/test_cli.py does
    so wholly.
    """
    compile_quickly()
    base = tmp_path_factory.getbasetemp()
    shared = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "xla"
    jax.config.update("jax_compilation_cache_dir", os.environ.get("EAR_JAX_TEST_CACHE") or str(shared))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working directory without records; experiments see only those that a test makes there."""
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
    """Runs of one configuration share one compiled program; compiling is most of the cost of a small run."""
    monkeypatch.setattr(on_host, "compile_program", compile_once)


@pytest.fixture(scope="session")
def finished_once(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that is trained once for all tests, and that none may change."""
    directory = tmp_path_factory.mktemp("finished") / "run"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(on_host, "compile_program", compile_once)
        train_run(finished_config(), directory)
    return directory


@pytest.fixture
def finished(finished_once: Path, tmp_path: Path) -> Path:
    """A copy of the finished run, which a test may change."""
    return Path(shutil.copytree(finished_once, tmp_path / "finished"))


@pytest.fixture
def refusal(finished, monkeypatch) -> Callable[..., str]:
    """Returns the message with which training that run is refused, before anything is compiled or written."""
    monkeypatch.setattr(on_host, "compile_program", lambda *_: pytest.fail("it came to compiling"))

    def refuse(config: Config) -> str:
        before = times(finished)
        with pytest.raises((UsageError, RunError)) as raised:
            train_run(config, finished)
        assert times(finished) == before
        assert "\n" not in str(raised.value)
        return str(raised.value)

    return refuse


@pytest.fixture
def small_files() -> Iterator[Callable[[int], AbstractContextManager[None]]]:
    """Limits the size of files, in bytes, while entered, as a full disk would; goes with `stray_writes`."""

    @contextmanager
    def limited(size: int) -> Iterator[None]:
        before = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
        try:
            yield
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)

    yield limited
    gc.collect()  # so that stray writes are reported here, and not in another test
