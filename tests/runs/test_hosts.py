"""Runs over two hosts, emulated by two processes of this machine."""

from __future__ import annotations

import dataclasses
import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from ear_jax.config import CheckpointConfig, Config
from ear_jax.runs import checkpoint, on_host, records
from ear_jax.runs.loop import train_run
from tests.helpers.quick import shared_cache
from tests.helpers.runs import last_state, leaves, step_arrays, sweep_words, tiny_config, words
from tests.helpers.toy import compile_toy

ROOT = Path(__file__).parents[2]
QUICK = "tests.helpers.quick"
DEVICES = "--xla_force_host_platform_device_count="


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as server:
        return server.getsockname()[1]


def command(
    config: Config,
    run: Path,
    devices: int,
    hosts: tuple[int, int, int] | None = None,
    program: str = QUICK,
    vary: tuple[str, ...] = (),
) -> dict[str, object]:
    """Returns how a process of a run or of a sweep is started.

    Args:
      config: the run's.
      run: its directory.
      devices: emulated, of each process.
      hosts: port of the coordinator, number of processes and index of this one.
      program: a module that stands for `ear`.
      vary: the setting that varies in a sweep, and its values.
    """
    given = sweep_words(config, *vary) if vary else words(config)
    line = [sys.executable, "-m", program, *given, "--out", str(run)]
    if hosts:
        port, count, index = hosts
        line += ["--hosts.coordinator", f"127.0.0.1:{port}", "--hosts.count", str(count), "--hosts.index", str(index)]
    environment = {**os.environ, **shared_cache(), "XLA_FLAGS": f"{DEVICES}{devices}"}
    environment |= {"PYTHONPATH": str(ROOT), "JAX_PLATFORMS": "cpu"}
    return {"args": line, "env": environment, "text": True, "stderr": subprocess.PIPE, "stdout": subprocess.PIPE}


@contextmanager
def started(
    config: Config, run: Path, count: int, devices: int = 1, **how: object
) -> Iterator[list[subprocess.Popen[str]]]:
    """Starts a run over hosts; ends what is left of it."""
    port = free_port()
    processes = [
        subprocess.Popen(**command(config, run, devices, (port, count, index), **how)) for index in range(count)
    ]
    try:
        yield processes
    finally:
        for process in processes:
            process.kill()
            process.communicate()


def trained(config: Config, run: Path, count: int, devices: int = 1, **how: object) -> tuple[str, ...]:
    """Trains on hosts, or on one without naming it; returns what each process said."""
    if count == 1:
        done = subprocess.run(**command(config, run, devices, **how), timeout=600)
        assert done.returncode == 0, done.stderr
        return (done.stderr,)
    with started(config, run, count, devices, **how) as processes:
        printed, said = zip(*(process.communicate(timeout=600) for process in processes), strict=True)
        assert [process.returncode for process in processes] == [0] * count, said
        assert not any(printed[1:]), "process 0 prints"
    return said


def wait_for(process: subprocess.Popen[str], happened: Callable[[], bool]) -> None:
    until = time.monotonic() + 300
    while not happened():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < until
        time.sleep(0.01)


def rows_of(run: Path) -> list[dict[str, object]]:
    return [row | {"seconds": 0} for row in records.read_rows(run / "metrics.jsonl")]


def states(run: Path, config: Config) -> list[np.ndarray]:
    return leaves(last_state(run, config))


def assert_equal_bits(one: Path, other: Path, config: Config) -> None:
    for mine, theirs in zip(states(one, config), states(other, config), strict=True):
        np.testing.assert_array_equal(mine, theirs)
    assert rows_of(one) == rows_of(other)


def assert_close(one: Path, other: Path, epoch: int) -> None:
    """Asserts equal learners at an epoch but for rounding, which grows from then on."""
    states = [step_arrays(run, epoch) for run in (one, other)]
    for name in states[0]:
        if name.startswith("learner."):
            np.testing.assert_allclose(*(state[name] for state in states), rtol=2e-3, atol=2e-5)


def ended(index: int) -> str:
    """Returns the line with which a process ends because that one has."""
    name = f"process {index}" + (f" on {socket.gethostname()}" if index else "")
    return f"ear: {name} has ended, and this process ends too; the same command continues the run"


def four_seeds(**changes: object) -> Config:
    return tiny_config(**{"seeds": 4, "epochs": 8, "checkpoint": CheckpointConfig(blocks=1), **changes})


def test_a_host_is_killed_the_other_ends_and_one_host_continues(tmp_path, monkeypatch):
    """Of a training whose arithmetic is a toy's: the same bits, on two hosts and then on this one, as here alone."""
    run = tmp_path / "run"
    with started(four_seeds(epochs=100_000), run, count=2, program="tests.helpers.toy") as processes:
        wait_for(processes[0], lambda: len(checkpoint.steps(run / "checkpoints")) > 2)
        processes[1].kill()
        printed, said = processes[0].communicate(timeout=30)
    assert processes[0].returncode == 1
    assert printed == ""
    assert "seeds 0–3 on 2 hosts" in said
    assert [line for line in said.splitlines() if line.startswith("ear: ")] == [ended(1)]
    epochs = checkpoint.newest(run / "checkpoints", pytest.fail).epoch + 4
    monkeypatch.setattr(on_host, "compile_program", compile_toy)
    for directory in (run, tmp_path / "alone"):
        train_run(four_seeds(epochs=epochs), directory)
    assert rows_of(run) == rows_of(tmp_path / "alone")
    assert [row["seed"] for row in rows_of(run)] == [0, 1, 2, 3] * (epochs // 2)
    arrays = [step_arrays(directory) for directory in (run, tmp_path / "alone")]
    assert arrays[0].keys() == arrays[1].keys()
    assert all(np.array_equal(array, arrays[1][name]) for name, array in arrays[0].items())


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of four seeds on one host with two devices, which none may change."""
    run = tmp_path_factory.mktemp("whole") / "run"
    trained(four_seeds(), run, count=1, devices=2)
    return run


@pytest.mark.slow
def test_four_seeds_on_two_hosts_are_those_of_one(whole, tmp_path):
    config = four_seeds()
    trained(config, tmp_path / "two", count=2)
    assert_equal_bits(tmp_path / "two", whole, config)  # two devices, which compute the same seeds
    trained(config, tmp_path / "one", count=1)
    assert_close(tmp_path / "one", whole, epoch=4)


@pytest.mark.slow
def test_saved_on_two_hosts_continued_on_one_and_back(whole, tmp_path):
    run = tmp_path / "run"
    for epochs, count, devices in ((2, 2, 1), (4, 1, 2), (8, 2, 1)):
        trained(four_seeds(epochs=epochs), run, count, devices)
    assert_equal_bits(run, whole, four_seeds())


@pytest.mark.slow
@pytest.mark.parametrize("killed", [0, 1])
def test_a_killed_host_ends_the_other_with_one_line_and_the_same_command_continues(killed, tmp_path):
    config, run = four_seeds(epochs=2000), tmp_path / "run"
    with started(config, run, count=2) as processes:
        wait_for(processes[0], lambda: len(checkpoint.steps(run / "checkpoints")) > 1)
        processes[killed].kill()
        began = time.monotonic()
        _, said = processes[1 - killed].communicate(timeout=30)
        assert time.monotonic() - began < 30
    assert processes[1 - killed].returncode == 1
    assert [line for line in said.splitlines() if line.startswith("ear: ")] == [ended(killed)]
    assert "Traceback" not in said
    assert killed == 1 or said.count("\n") == 1, "process 1 says nothing else"
    reached = checkpoint.newest(run / "checkpoints", pytest.fail).epoch
    config = four_seeds(epochs=reached + 2)
    trained(config, run, count=2)
    trained(config, tmp_path / "whole", count=1, devices=2)
    assert_equal_bits(run, tmp_path / "whole", config)


@pytest.mark.slow
def test_a_sweep_over_two_hosts_is_that_of_one_which_also_continues_it(tmp_path):
    """Of trials of one seed, which no trial alone could spread over the hosts."""
    config, vary = tiny_config(checkpoint=CheckpointConfig(blocks=1)), ("sac.lr", "1e-4", "3e-3")
    half = dataclasses.replace(config, epochs=2)
    said = trained(half, tmp_path / "two", count=2, vary=vary)
    assert "on 2 hosts" in said[0]
    assert said[1] == "", "process 0 tells"
    for name in ("two", "one"):
        trained(config, tmp_path / name, count=1, devices=2, vary=vary)
    documents = [records.read_json(tmp_path / name / "sweep.json") for name in ("two", "one")]
    assert [trial["return"] for trial in documents[0]["trials"]] == [
        trial["return"] for trial in documents[1]["trials"]
    ]
    for value in vary[1:]:
        trial = f"sac.lr={value}"
        assert_equal_bits(tmp_path / "two" / trial, tmp_path / "one" / trial, config)
    states_of_trials = [states(tmp_path / "one" / f"sac.lr={value}", config) for value in vary[1:]]
    assert not all(map(np.array_equal, *states_of_trials))
