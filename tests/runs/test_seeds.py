"""Seeds spread over several devices train as on one."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from ear_jax.runs import records, seeds
from ear_jax.runs.loop import train_run
from tests.helpers.quick import shared_cache
from tests.helpers.runs import last_state, leaves, tiny_config


@pytest.mark.parametrize(("devices", "wanted", "used"), [(1, 3, 1), (2, 3, 1), (2, 4, 2), (4, 6, 3), (8, 5, 5)])
def test_as_many_devices_as_divide_the_seeds(devices, wanted, used, monkeypatch):
    monkeypatch.setattr(seeds.jax, "local_device_count", lambda: devices)
    assert seeds.devices_for(wanted) == used


@pytest.mark.usefixtures("compiled_once")
def test_a_run_on_two_devices_is_the_run_on_one_and_goes_on_there(tmp_path):
    """Trains on two emulated devices, a seed on each, then both seeds on the one device of this process."""
    config = tiny_config(seeds=2)
    code = """
import sys; sys.path.insert(0, sys.argv[1])
from pathlib import Path
import jax
from tests.helpers.quick import compile_quickly
from tests.helpers.runs import tiny_config
from ear_jax.runs import loop
compile_quickly()
devices = []
save = loop._save
loop._save = lambda directory, state, *rest: (
    devices.append(len(jax.tree.leaves(state.learner)[0].sharding.device_set)), save(directory, state, *rest)
)
loop.train_run(tiny_config(seeds=2, epochs=2), Path(sys.argv[2]))
assert devices == [2], devices
"""
    two = {"XLA_FLAGS": "--xla_force_host_platform_device_count=2", "JAX_PLATFORMS": "cpu"}
    environment = {**os.environ, **shared_cache(), **two}
    arguments = [str(Path(__file__).parents[2]), str(tmp_path / "two")]
    subprocess.run([sys.executable, "-c", code, *arguments], env=environment, check=True, timeout=300)
    train_run(config, tmp_path / "two")
    train_run(config, tmp_path / "one")
    rows = [records.read_rows(tmp_path / name / "metrics.jsonl") for name in ("one", "two")]
    assert [[(row["seed"], row["epoch"]) for row in of_run] for of_run in rows] == [
        [(0, 2), (1, 2), (0, 4), (1, 4)]
    ] * 2
    states = [last_state(tmp_path / name, config) for name in ("one", "two")]
    for one, other in zip(*(leaves(state.learner) for state in states), strict=True):
        np.testing.assert_allclose(one, other, rtol=2e-3, atol=2e-5)
