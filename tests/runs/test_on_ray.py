"""Runs as tasks of a Ray cluster of two nodes on this machine, one of which dies."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
import types
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from ear_jax.cli.main import main
from ear_jax.config import CheckpointConfig, Config
from ear_jax.errors import RunError
from ear_jax.runs import checkpoint, on_host, on_ray, records
from ear_jax.runs.loop import train_run
from tests.helpers.raylets import two_nodes
from tests.helpers.runs import step_arrays, sweep_words, tiny_config, words
from tests.helpers.toy import compile_toy

ROOT = Path(__file__).parents[2]
HERE = {**os.environ, "PYTHONPATH": str(ROOT), "RAY_USAGE_STATS_ENABLED": "0", "JAX_PLATFORMS": "cpu"}
DRIVER = """
import json, sys
from pathlib import Path
from ear_jax.cli.exits import exit_code
from ear_jax.runs.on_ray import Job, check, run_jobs
jobs = [Job(name, tuple(words), Path(run), epochs) for name, words, run, epochs in json.loads(sys.argv[1])]
sys.exit(exit_code("ear", lambda: check(run_jobs(jobs, Path("logs"), 1), Path("logs"))))
"""


@pytest.fixture
def cluster(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[subprocess.Popen[str]]:
    """The process of a cluster whose address is in HERE."""
    pytest.importorskip("ray", reason="Ray is not installed: pip install 'ear-jax[cluster]'")
    with two_nodes({**HERE, "EAR_JAX_CACHE": str(tmp_path / "cache")}) as (process, address):
        monkeypatch.setitem(HERE, "RAY_ADDRESS", address)
        yield process


def seeds_apart(count: int, **changes: object) -> list[Config]:
    return [tiny_config(seed=seed, checkpoint=CheckpointConfig(blocks=8), **changes) for seed in range(count)]


def drive(configs: list[Config], where: Path) -> subprocess.Popen[str]:
    """Starts a process that trains configurations on the cluster, in runs named by their seeds."""
    jobs = []
    for config in configs:
        run = where / f"seed{config.seed}"
        line = ("tests.helpers.toy", *words(config), "--out", str(run))
        jobs.append((run.name, line, str(run), config.epochs))
    command = [sys.executable, "-c", DRIVER, json.dumps(jobs)]
    return subprocess.Popen(command, cwd=where, env=HERE, stderr=subprocess.PIPE, text=True)


def wait_for(process: subprocess.Popen[str], happened: Callable[[], bool]) -> None:
    until = time.monotonic() + 300
    while not happened():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < until
        time.sleep(0.05)


def trainers() -> list[str]:
    """Returns the command lines of processes that train for these tests."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            line = path.read_bytes()
        except OSError:
            continue
        if b"tests.helpers.toy" in line and b"seed0" in line:
            found.append(line.decode().replace("\0", " "))
    return found


@pytest.mark.slow
def test_a_node_dies_and_all_runs_end_as_if_each_had_been_alone(cluster, tmp_path, monkeypatch):
    """The arithmetic of the runs is a toy's."""
    configs = seeds_apart(6, epochs=160)
    with drive(configs, tmp_path) as driver:
        runs = [tmp_path / f"seed{config.seed}" for config in configs]
        wait_for(driver, lambda: sum(len(checkpoint.steps(run / "checkpoints")) > 1 for run in runs) > 1)
        cluster.stdin.write("kill\n")
        cluster.stdin.flush()
        _, said = driver.communicate(timeout=550)
        assert driver.returncode == 0, said
    again = [run for run in runs if (tmp_path / "logs" / f"{run.name}.log").read_text().count("compiling …") > 1]
    assert len(again) == 1, "the one on the node that died"
    assert all(f"{run.name}: done" in said for run in runs)
    assert len([line for line in said.splitlines() if "160/160" in line]) == 6, "the table"
    monkeypatch.setattr(on_host, "compile_program", compile_toy)
    for config, run in zip(configs, runs, strict=True):
        alone = tmp_path / "alone" / run.name
        train_run(config, alone)
        rows = [records.read_rows(directory / "metrics.jsonl") for directory in (run, alone)]
        assert [row | {"seconds": 0} for row in rows[0]] == [row | {"seconds": 0} for row in rows[1]]
        (mine, own) = (step_arrays(directory) for directory in (run, alone))
        assert mine.keys() == own.keys()
        assert all(np.array_equal(mine[name], own[name]) for name in mine)


@pytest.mark.slow
def test_ctrl_c_stops_all_runs_after_their_block(cluster, tmp_path):
    configs = seeds_apart(3, epochs=100_000)
    with drive(configs, tmp_path) as driver:
        wait_for(driver, lambda: bool(checkpoint.steps(tmp_path / "seed0" / "checkpoints")))
        driver.send_signal(signal.SIGINT)
        _, said = driver.communicate(timeout=120)
    assert driver.returncode == 130
    assert "all runs are stopped; the same command continues them" in said
    assert not trainers()
    rows = records.read_rows(tmp_path / "seed0" / "metrics.jsonl")
    assert checkpoint.newest(tmp_path / "seed0" / "checkpoints", pytest.fail).epoch == rows[-1]["epoch"]


@pytest.mark.slow
def test_a_driver_that_is_killed_leaves_nothing_running(cluster, tmp_path):
    with drive(seeds_apart(2, epochs=100_000), tmp_path) as driver:
        wait_for(driver, lambda: bool(checkpoint.steps(tmp_path / "seed0" / "checkpoints")))
        driver.kill()
    until = time.monotonic() + 60
    while trainers() and time.monotonic() < until:
        time.sleep(0.5)
    assert not trainers()


@pytest.mark.slow
def test_a_sweep_on_the_cluster_is_told_like_one_here(cluster, tmp_path):
    config = tiny_config(epochs=2, seeds=2)

    def swept(*values: str) -> subprocess.CompletedProcess[str]:
        line = [sys.executable, "-m", "ear_jax.cli.main", *sweep_words(config, "sac.lr", *values)]
        line += ["--on", "ray", "--out", "sweep", "--json"]
        return subprocess.run(line, cwd=tmp_path, env=HERE, capture_output=True, text=True, timeout=400)

    assert swept("1e-3", "2").returncode == 2, "a step size of 2 is refused before anything starts"
    done = swept("1e-3", "1e-4")
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    assert {trial["name"] for trial in document["trials"]} == {"sac.lr=1e-3", "sac.lr=1e-4"}
    assert all(len(trial["seeds"]) == 2 and trial["failed"] is None for trial in document["trials"])


def test_a_cluster_out_of_reach_is_told_in_one_line():
    def init(**_: object) -> None:
        raise ConnectionError("no such address\n(many more lines)")

    connected = on_ray._connected(types.SimpleNamespace(init=init))
    with pytest.raises(RunError, match=r"^Ray cannot start or be reached: .*no such address$"), connected:
        pass


def test_runs_that_failed_are_named_with_what_they_said():
    on_ray.check({}, Path("logs"))
    with pytest.raises(RunError, match=r"^2 runs failed: a: full; b: killed \(all they said is in logs\)$"):
        on_ray.check({"a": "full", "b": "killed"}, Path("logs"))


def test_without_ray_one_line_names_the_extra(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, "ray", None)
    assert main(["sweep", "hopper-vel", "--vary", "sac.lr", "1e-3", "1e-4", "--on", "ray"]) == 1
    assert capsys.readouterr().err == "ear: --on ray needs Ray, of the extra cluster: pip install 'ear-jax[cluster]'\n"
    assert not list(tmp_path.iterdir())
