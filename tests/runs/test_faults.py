"""Runs that are killed, stopped or short of disk, as they happen to a user."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from ear_jax.cli.main import main
from ear_jax.config import CheckpointConfig, Config, LogConfig
from ear_jax.errors import RunError
from ear_jax.presets import preset_config
from ear_jax.runs import checkpoint, loop, records
from ear_jax.runs.loop import train_run
from ear_jax.runs.trained import load
from tests.helpers.faults import killed_before
from tests.helpers.quick import shared_cache
from tests.helpers.runs import assert_same_run, finished_config, last_state, stray_writes, words

ROOT = Path(__file__).parents[2]


@contextmanager
def training(config: Config, directory: Path, said: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Runs `ear train` in a process of its own, whose stderr goes to a file."""
    command = [sys.executable, "-m", "tests.helpers.quick", *words(config), "--out", str(directory)]
    environment = {**os.environ, **shared_cache(), "PYTHONPATH": str(ROOT)}
    with said.open("wb") as stderr, subprocess.Popen(command, env=environment, stderr=stderr) as process:
        try:
            yield process
        finally:
            process.kill()


def wait_for(process: subprocess.Popen[bytes], happened: Callable[[], bool], seconds: float = 600) -> None:
    """Looks a thousand times a second; fails if the process ends before it happens."""
    until = time.monotonic() + seconds
    while not happened():
        assert process.poll() is None, f"it ended with {process.returncode} before that"
        assert time.monotonic() < until, "it takes too long"
        time.sleep(0.001)


def is_saving(directory: Path, since: float) -> bool:
    """Returns whether a step is being written that was begun since then, and not left by a killed process."""
    with contextlib.suppress(FileNotFoundError):
        return any(path.stat().st_mtime > since for path in (directory / "checkpoints").glob(".*.part"))
    return False


def test_killed_in_a_save_and_stopped_after_that_it_ends_as_if_nothing_had_been(
    finished_once, tmp_path, monkeypatch, compiled_once, capsys
):
    config, directory = finished_config(), tmp_path / "run"
    with training(config, directory, tmp_path / "said") as process:
        wait_for(process, lambda: (directory / "checkpoints" / ".12.part").exists())
        process.kill()
    command = [*words(config), "--out", str(directory)]
    append, sent = records.append_rows, []

    def append_and_stop(*rows):
        if not sent:  # a second one would end this process at once
            sent.append(os.kill(os.getpid(), signal.SIGTERM))
        return append(*rows)

    with monkeypatch.context() as patch:
        patch.setattr(records, "append_rows", append_and_stop)
        assert main(command) == 143
    said = capsys.readouterr().err
    assert f"process {process.pid} on " in said
    assert "restoring epoch 6" in said
    stopped = records.read_rows(directory / "metrics.jsonl")[-1]["epoch"]
    assert f"stopped at epoch {stopped}; the same command continues" in said
    assert checkpoint.steps(directory / "checkpoints")[-1] == stopped < 24
    assert main(command) == 0
    assert_same_run(directory, finished_once, config)


@stray_writes
@pytest.mark.parametrize("kills", [3, pytest.param(40, marks=pytest.mark.slow)])
def test_killed_at_changes_of_the_file_system_it_ends_as_if_nothing_had_been(
    kills, finished_once, tmp_path, compiled_once
):
    killed_and_continued(finished_config(), tmp_path / "run", kills)
    assert_same_run(tmp_path / "run", finished_once, finished_config())


def killed_and_continued(config: Config, directory: Path, kills: int) -> None:
    """Trains a run that is killed before some of its changes of the file system."""
    dice = random.Random(0)
    for _ in range(kills):
        with killed_before(dice.randrange(1, 100)):
            train_run(config, directory)
    train_run(config, directory)


AGENTS = [("ear", 1), ("ear", 2), ("ear-rnn", 1), ("pearl", 1), ("maml", 1)]


def config_of(agent: str, seeds: int, **changes: object) -> Config:
    """Configures a small run of a method."""
    base = preset_config("halfcheetah-vel", "smoke", agent)
    small: dict[str, object] = {"network": dataclasses.replace(base.network, width=16)}
    if agent != "maml":  # which needs whole episodes, and has no replay
        small["sac"] = dataclasses.replace(base.sac, batch_size=32, updates=4)
        small["collect"] = dataclasses.replace(base.collect, envs=2, steps=5, pretrain_epochs=2)
        small["replay"] = dataclasses.replace(base.replay, capacity=400)
    small |= {"log": LogConfig(epochs=2, episodes=1), "tasks": ("1", "3"), "engine": "native"}
    return dataclasses.replace(base, seeds=seeds, **{**small, **changes})


@stray_writes
@pytest.mark.slow
@pytest.mark.parametrize(("agent", "seeds"), AGENTS)
def test_so_does_every_method(agent, seeds, tmp_path, compiled_once):
    config = config_of(agent, seeds, epochs=12, checkpoint=CheckpointConfig(blocks=2))
    train_run(config, tmp_path / "whole")
    killed_and_continued(config, tmp_path / "run", 12)
    assert_same_run(tmp_path / "run", tmp_path / "whole", config)


MOMENTS = ("pretraining", "pretraining", *("training", "saving") * 5)


@pytest.mark.slow
@pytest.mark.parametrize(("agent", "seeds"), AGENTS)
def test_killed_at_twelve_random_moments_it_ends_as_if_nothing_had_been(agent, seeds, tmp_path):
    """Two kills are in pretraining, five in training and five in saving, each a few tenths of a second in."""
    config = config_of(agent, seeds, epochs=60 if agent == "maml" else 600, checkpoint=CheckpointConfig(blocks=4))
    directory, said, dice = tmp_path / "run", tmp_path / "said", random.Random(0)
    for moment in MOMENTS:
        began = time.time()
        with training(config, directory, said) as process:
            wait_for(process, lambda: "compiling:" in said.read_text())
            if moment == "saving":
                wait_for(process, lambda: is_saving(directory, began))  # noqa: B023
                time.sleep(dice.uniform(0, 0.1))
            elif moment == "training":
                wait_for(process, lambda: re.search(r"epoch \d+/", said.read_text()) is not None)
                time.sleep(dice.uniform(0, 0.5))
            else:
                time.sleep(dice.uniform(0, 1.0))
            assert process.poll() is None, f"it came to its end before it was killed while {moment}"
            process.kill()
    with training(config, directory, said) as process:
        assert process.wait(600) == 0, said.read_text()
    train_run(config, tmp_path / "whole")
    assert_same_run(directory, tmp_path / "whole", config)


@pytest.mark.slow
def test_a_policy_is_read_at_any_moment_of_its_training(tmp_path):
    """Checkpoints are saved every block, and older ones removed, all the while."""
    config = config_of("ear", 1, epochs=400, checkpoint=CheckpointConfig(blocks=1))
    directory, read = tmp_path / "run", []
    with training(config, directory, tmp_path / "said") as process:
        wait_for(process, lambda: len(checkpoint.steps(directory / "checkpoints")) > 1)
        while process.poll() is None:
            read.append(load(directory).epoch)
        assert process.returncode == 0, (tmp_path / "said").read_text()
    assert read == sorted(read)
    assert len(set(read)) > 10


@pytest.mark.slow
def test_a_reader_of_stderr_that_leaves_does_not_end_a_run(tmp_path):
    command = [sys.executable, "-m", "tests.helpers.quick", *words(finished_config()), "--out", str(tmp_path / "run")]
    environment = {**os.environ, **shared_cache(), "PYTHONPATH": str(ROOT)}
    with subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) as process:
        process.stderr.readline()
        process.stderr.close()
        assert process.wait(600) == 0
    assert checkpoint.newest(tmp_path / "run" / "checkpoints", pytest.fail).epoch == 24


@pytest.mark.slow
def test_on_one_core_and_on_two_it_ends_the_same(tmp_path):
    if (os.cpu_count() or 1) < 2:
        pytest.skip("this machine has one core")
    config, before = config_of("ear", 2, epochs=8), os.sched_getaffinity(0)
    try:
        for cores in ((0,), (0, 1)):
            os.sched_setaffinity(0, cores)  # which processes inherit
            with training(config, tmp_path / str(len(cores)), tmp_path / "said") as process:
                assert process.wait(600) == 0, (tmp_path / "said").read_text()
    finally:
        os.sched_setaffinity(0, before)
    assert_same_run(tmp_path / "1", tmp_path / "2", config)


@stray_writes
def test_a_full_disk_is_reported_and_the_run_goes_on(finished, monkeypatch, small_files, capsys, compiled_once):
    save = checkpoint.save

    def with_little_room(*arguments):
        with small_files(20_000):
            save(*arguments)

    monkeypatch.setattr(loop.checkpoint, "save", with_little_room)
    config = finished_config(epochs=28, checkpoint=CheckpointConfig(blocks=1))
    with pytest.raises(RunError, match=r"epoch 28 could not be written: .*File too large.* continues from the prev"):
        train_run(config, finished)
    assert "warning: the checkpoint of epoch 26 could not be written" in capsys.readouterr().err
    assert checkpoint.newest(finished / "checkpoints", pytest.fail).epoch == 24
    monkeypatch.setattr(loop.checkpoint, "save", save)
    train_run(config, finished)
    assert [row["epoch"] for row in records.read_rows(finished / "metrics.jsonl")][-6::2] == [24, 26, 28]


@pytest.mark.slow
def test_on_a_small_file_system_that_fills_up(tmp_path):
    """The first checkpoint takes 6 of 9 MB, and the second has no room beside it."""
    disk, said = tmp_path / "disk", tmp_path / "said"
    disk.mkdir()
    mount = shutil.which("mount")
    mounting = ["mount", "-t", "tmpfs", "-o", "size=9m", "tmpfs", str(disk)]
    if mount is None or subprocess.run(mounting, capture_output=True).returncode:
        pytest.skip("no file system can be mounted here; a limit of file sizes stands in for it in the short test")
    try:
        config = finished_config(epochs=8, checkpoint=CheckpointConfig(blocks=1))
        collect = dataclasses.replace(config.collect, envs=25, steps=100)
        replay = dataclasses.replace(config.replay, capacity=40_000)
        config = dataclasses.replace(config, collect=collect, replay=replay)
        with training(config, disk / "run", said) as process:
            assert process.wait(600) == 1, said.read_text()
        assert "No space left on device" in said.read_text()
        assert "Traceback" not in said.read_text()
        good = checkpoint.newest(disk / "run" / "checkpoints", pytest.fail)
        assert good.epoch == 2
        last_state(disk / "run", config)
    finally:
        subprocess.run(["umount", str(disk)], check=True)


def test_without_its_replay_a_checkpoint_is_small_and_continuing_says_what_it_costs(
    finished, capsys, compiled_once, monkeypatch
):
    config, steps = finished_config(epochs=26), finished / "checkpoints"
    small = dataclasses.replace(config, checkpoint=CheckpointConfig(replay=False))
    train_run(small, finished)
    step = checkpoint.newest(steps, pytest.fail)
    assert (step.epoch, step.about["replay"]) == (26, False)
    assert not any(name.startswith("replay") for name in step.about["leaves"])
    capsys.readouterr()
    monkeypatch.setattr(loop, "differences", lambda *_: ["jax was 0.1, is 0.2"])
    train_run(dataclasses.replace(config, epochs=28), finished)
    said = capsys.readouterr().err
    assert "warning: jax was 0.1, is 0.2: results may differ in the last bit" in said
    assert "epoch 26 was saved without its replay; 2 epochs of collection (40 env steps per seed) refill it" in said
    rows = records.read_rows(finished / "metrics.jsonl")
    # 2 tasks × 2 envs × 5 steps an epoch; 2 epochs of pretraining, and 2 more
    assert [(row["epoch"], row["env_steps"]) for row in rows[-4::2]] == [(26, 560), (28, 640)]
    assert checkpoint.newest(steps, pytest.fail).about["replay"]
