"""The room for memory is that of the nearest limit: the machine's, a control group's or one of `ulimit`."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from ear_jax.errors import RunError
from ear_jax.process import memory
from ear_jax.process.memory import Room
from ear_jax.runs import estimate
from ear_jax.runs.training import make_program
from tests.helpers.runs import tiny_config

ROOT = Path(__file__).parents[2]
HERE = {**os.environ, "PYTHONPATH": str(ROOT)}


@pytest.fixture
def machine(tmp_path, monkeypatch):
    """Makes a machine with 8 GB free; returns a function that writes its files."""
    monkeypatch.setattr(memory, "PROC", tmp_path / "proc")
    monkeypatch.setattr(memory, "GROUPS", tmp_path / "groups")

    def write(**files: str) -> None:
        for name, content in files.items():
            path = tmp_path / name.replace("__", "/")
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(content)

    write(proc__meminfo="MemTotal: 9000000 kB\nMemAvailable:    8000000 kB\n")
    return write


def nearest() -> Room:
    return min(memory.available(), key=lambda room: room.bytes)


def test_without_limits_it_is_what_the_machine_has(machine):
    assert memory.available() == [Room(8_192_000_000, "the machine's memory")]


def test_a_control_group_of_version_2_and_those_above_it_are_read(machine, tmp_path):
    machine(proc__self__cgroup="0::/pod/box\n")
    for group, limit in (("pod", "900000000"), ("pod/box", "max")):
        folder = tmp_path / "groups" / group
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "memory.max").write_text(limit + "\n")
        (folder / "memory.current").write_text("500000000\n")
        (folder / "memory.stat").write_text("anon 1\ninactive_file 100000000\n")
    assert nearest() == Room(500_000_000, "the control group's limit of 0.90 GB"), "pages of files are given back"


def test_a_control_group_of_version_1_is_read_also_where_its_path_is_the_hosts(machine, tmp_path):
    machine(proc__self__cgroup="5:cpu:/\n4:cpuset,memory:/docker/1f\n0::/\n")
    folder = tmp_path / "groups" / "memory"
    folder.mkdir(parents=True)
    (folder / "memory.limit_in_bytes").write_text("2000000000\n")
    (folder / "memory.usage_in_bytes").write_text("1500000000\n")
    (folder / "memory.stat").write_text("total_inactive_file 250000000\n")
    assert nearest() == Room(750_000_000, "the control group's limit of 2.00 GB")


@pytest.mark.parametrize(
    ("room", "said"),
    [
        (
            Room(300_000_000, "the control group's limit of 0.90 GB"),
            "only 0.30 GB is free under the control group",
        ),
        (Room(-1, "`ulimit -v` of 1.50 GB", virtual=True), "only 0.00 GB is free under `ulimit -v` of 1.50 GB; lower"),
        (
            Room(100, "the device's memory", of_device=True),
            "compiling 0.00 GB, saving 0.00 GB), but only 0.00 GB",
        ),
    ],
)
def test_a_run_is_refused_with_the_limit_that_refuses_it(room, said, monkeypatch):
    """It is refused for its program and its saves also where its state would fit."""
    monkeypatch.setattr(estimate, "available", lambda devices: [Room(10**12, "the machine's memory"), room])
    with pytest.raises(RunError) as raised:
        estimate.check_memory(make_program(tiny_config()))
    assert said in str(raised.value)
    monkeypatch.setattr(estimate, "available", lambda devices: [Room(10**12, "the machine's memory")])
    estimate.check_memory(make_program(tiny_config()))


@pytest.mark.parametrize("gigabytes", [0.9, 1.2, 1.5])
def test_under_a_limit_of_the_shell_training_is_refused_in_words(gigabytes, tmp_path):
    """JAX ends by a signal where its threads find no room."""
    words = ["train", "halfcheetah-vel", "--out", str(tmp_path / "run")]
    command = f"ulimit -v {int(gigabytes * 1e6)}; exec {sys.executable} -m ear_jax.cli.main {' '.join(words)}"
    done = subprocess.run(["sh", "-c", command], env=HERE, capture_output=True, text=True, timeout=120)
    assert done.returncode == 1
    assert f"GB is free under `ulimit -v` of {gigabytes * 1.024:.2f} GB; raise that limit" in done.stderr
    assert done.stderr.count("\n") == 1
