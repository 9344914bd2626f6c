"""Processes that share a table, some of which are killed."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from dataclasses import asdict
from pathlib import Path

import pytest

from experiments import inventory
from experiments.inventory import Job, is_complete, jobs
from experiments.paper import EXPERIMENTS
from tests.helpers.raylets import two_nodes

ROOT = Path(__file__).parents[2]
# `ear` with a training of half a second, which it continues after a stop; nobody else may train there meanwhile.
EAR = """
import fcntl, json, signal, sys, time
from pathlib import Path
command, *words = sys.argv[1:]
def log(line):
    with open("log", "a") as file:
        file.write(line + chr(10))
if command == "train":
    given = dict(zip(words[1::2], words[2::2]))
    name = f"{words[0]}-{given['--agent']}-{given['--preset']}-seed{given['--seed']}"
    run = Path("runs") / name
    run.mkdir(parents=True, exist_ok=True)
    lock = open(run / "lock", "w")
    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    done = run / "steps"
    steps = int(done.read_text()) if done.exists() else 0
    if steps == 25:
        sys.exit()
    def stop(*_):
        done.write_text(str(steps))
        sys.exit(143)
    signal.signal(signal.SIGTERM, stop)
    for steps in range(steps, 25):
        time.sleep(0.02)
    document = json.loads(Path("configs", name).read_text())
    (run / "config.json").write_text(json.dumps({"config": document}))
    row = {"epoch": document["epochs"], "mean_return": 1.0, "seconds": 1.0}
    (run / "metrics.jsonl").write_text(json.dumps(row) + chr(10))
    done.write_text("25")
    log(f"trained {name}")
elif command == "export":
    time.sleep(0.05)
    Path(words[1]).write_bytes(b"policy")
else:
    time.sleep(0.1)
    log(f"{command} {words[0]}")
    print("{}")
"""
INSTEAD = "del sys.modules['experiments']"  # of this package, the one that the next lines find
REPRODUCE = """
import sys; sys.path[0] = sys.argv.pop(1)
from pathlib import Path
from experiments import inventory, reproduce
from experiments.__main__ import main
inventory.RECORDS, reproduce.PAUSE = Path("records").absolute(), 0.1
sys.exit(main(sys.argv[1:]))
"""


def prepare(place: Path, seeds: int) -> list[Job]:
    """Puts that `ear` at a place, with the settings of the runs wanted there, which are returned."""
    for package in (place / "ear_jax", place / "ear_jax" / "cli", place / "configs"):
        package.mkdir()
        (package / "__init__.py").touch()
    (place / "ear_jax" / "cli" / "main.py").write_text(EAR)
    wanted = jobs(EXPERIMENTS["table-8"], "fast", seeds=seeds)
    for job in wanted:
        (place / "configs" / job.name).write_text(json.dumps(asdict(job.config)))
    return wanted


def assert_each_made_once(wanted: list[Job], place: Path) -> None:
    assert all(map(is_complete, wanted))
    names, log = {job.name for job in wanted}, (place / "log").read_text().splitlines()
    assert sorted(line for line in log if line.startswith("trained")) == sorted(f"trained {name}" for name in names)
    assert {line.split("/")[-1] for line in log if line.startswith("evaluate")} == names
    assert not list(inventory.RECORDS.glob(".*"))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_of_eight_processes_three_are_killed_and_every_run_is_made_once(seed, place):
    dice, wanted = random.Random(seed), prepare(place, seeds=8)
    line = [sys.executable, "-c", REPRODUCE, str(ROOT), "reproduce", "table-8", "--seeds", "8"]
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    workers = [subprocess.Popen(line, env=environment, stderr=subprocess.PIPE, text=True) for _ in range(8)]
    try:
        while not (place / "log").exists():
            time.sleep(0.01)
        victims = dice.sample(workers, 3)
        for victim in victims:
            time.sleep(dice.uniform(0, 0.7))
            assert victim.poll() is None, victim.stderr.read()
            victim.send_signal(signal.SIGKILL)
        said = {worker: worker.communicate(timeout=300)[1] for worker in workers}
    finally:
        for worker in workers:
            worker.kill()
    for worker in set(workers) - set(victims):
        assert worker.returncode == 0, said[worker]
        assert said[worker].endswith("table-8 is complete: 16 runs\n")
    assert_each_made_once(wanted, place)


@pytest.mark.slow
def test_on_a_ray_cluster_every_run_is_made_once(place):
    pytest.importorskip("ray", reason="Ray is not installed: pip install 'ear-jax[cluster]'")
    wanted, package = prepare(place, seeds=3), place / "experiments"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "__main__.py").write_text(f"import sys; sys.argv.insert(1, {str(ROOT)!r}); {INSTEAD}{REPRODUCE}")
    line = [sys.executable, "-m", "experiments", "reproduce", "table-8", "--seeds", "3", "--on", "ray"]
    with two_nodes({**os.environ, "PYTHONPATH": str(ROOT)}) as (_, address):
        environment = {**os.environ, "PYTHONPATH": "", "RAY_ADDRESS": address}
        done = subprocess.run(line, env=environment, capture_output=True, text=True, timeout=400)
    assert done.returncode == 0, done.stderr
    assert done.stderr.endswith("table-8 is complete: 6 runs\n")
    assert len([line for line in done.stderr.splitlines() if "│ done" in line]) == 6, "the table"
    assert_each_made_once(wanted, place)
