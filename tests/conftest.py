"""Shared by all tests: the machine's caches stay out of them, and small things to train."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import jax
import pytest

from ear_jax.config import Config, preset_config


@pytest.fixture(autouse=True, scope="session")
def _private_cache(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Compiled programs are shared between the tests of a session, and with nothing else."""
    jax.config.update("jax_compilation_cache_dir", str(tmp_path_factory.mktemp("xla")))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)


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
