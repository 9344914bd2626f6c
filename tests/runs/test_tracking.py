"""Copies of the metrics for TensorBoard and Weights & Biases: every row once, however often the run stops."""

from __future__ import annotations

import dataclasses
import json
import os
import re
import struct
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from tensorboardX.proto.event_pb2 import Event

from ear_jax.cli.main import main
from ear_jax.config import Config, LogConfig
from ear_jax.runs import records
from ear_jax.runs.lock import lock_directory
from ear_jax.runs.loop import train_run
from ear_jax.runs.tracking import scalars, tracking
from tests.helpers.records_of import write_records


def events(folder: Path) -> list[Event]:
    """Reads the event files of a folder: records of a length, its checksum, an event and its checksum."""
    found = []
    for path in sorted(folder.glob("events.out.tfevents.*")):
        content = path.read_bytes()
        while content:
            (length,) = struct.unpack("<Q", content[:8])
            found.append(Event.FromString(content[12 : 12 + length]))
            content = content[16 + length :]
    return found


def curves(folder: Path) -> dict[str, list[tuple[int, float]]]:
    """Returns the curves of a folder by name: pairs of step and value in the order written."""
    found: dict[str, list[tuple[int, float]]] = {}
    for event in events(folder):
        for value in event.summary.value:
            if value.HasField("simple_value"):
                found.setdefault(value.tag, []).append((event.step, value.simple_value))
    return found


@pytest.mark.usefixtures("compiled_once")
def test_a_run_that_stops_has_each_row_once_in_tensorboard(tiny, run_directory):
    train_run(dataclasses.replace(tiny, epochs=2), run_directory)
    assert not (run_directory / "tensorboard").exists()
    logged = dataclasses.replace(tiny, log=dataclasses.replace(tiny.log, tensorboard=True))  # a run may begin late
    train_run(logged, run_directory)
    train_run(dataclasses.replace(logged, epochs=6), run_directory)
    rows = records.read_rows(run_directory / "metrics.jsonl")
    found = curves(run_directory / "tensorboard" / "seed0")
    assert set(found) == set(scalars(rows[0]))
    for name in ("mean_return", "returns/vel-3", "critic_loss", "updates"):
        expected = [(row["env_steps"], scalars(row)[name]) for row in rows]
        assert found[name] == [(step, pytest.approx(value, rel=1e-6)) for step, value in expected]


def test_a_run_that_exists_is_copied_with_its_times(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    run = write_records(Path("run"), {0: [{"vel-1": 1}, {"vel-1": 2}], 1: [{"vel-1": 3}, {"vel-1": 4}]})
    assert main(["log", "run", "--tensorboard", "--json"]) == 0
    assert main(["log", "run", "--tensorboard"]) == 0  # again, in place of the first copy
    assert "4 rows" in capsys.readouterr().out
    folder = run / "tensorboard" / "seed1"
    assert curves(folder)["returns/vel-1"] == [(1000, 3), (2000, 4)]
    times = [event.wall_time for event in events(folder) if event.step]
    assert times[-1] - times[0] == pytest.approx(30)
    assert times[-1] == pytest.approx((run / "metrics.jsonl").stat().st_mtime)
    (settings,) = (value.tensor for event in events(folder) for value in event.summary.value if "settings" in value.tag)
    assert b"| sac.lr | 0.0003 |" in settings.string_val[0]


def test_a_run_that_is_training_is_not_copied(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    run = write_records(Path("run"), {0: [{"vel-1": 1}]})
    with lock_directory(run, print):
        assert main(["log", "run", "--tensorboard"]) == 1
    assert "run is in use; log it once its training has ended" in capsys.readouterr().err
    assert not (run / "tensorboard").exists()


def test_a_tracker_that_fails_ends_no_run(tmp_path, monkeypatch):
    run, warnings = write_records(tmp_path, {0: [{"vel-1": 1}]}), []
    with tracking(run, Config("halfcheetah-vel", log=LogConfig(tensorboard=True)), warnings.append) as track:
        (row,) = records.read_rows(run / "metrics.jsonl")
        monkeypatch.setattr("tensorboardX.event_file_writer.EventsWriter.write_event", lambda *_: 1 / 0)
        track([row])
        track([row])
    assert len(warnings) == 1
    assert "TensorBoard gets no more metrics: division by zero" in warnings[0]


def test_weights_and_biases_that_are_absent_are_one_line_before_training(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "wandb", None)
    write_records(tmp_path / "run", {0: [{"vel-1": 1}]})
    assert main(["log", str(tmp_path / "run"), "--wandb"]) == 1
    assert capsys.readouterr().err == "ear: Weights & Biases is not installed: pip install 'ear-jax[wandb]'\n"


@pytest.mark.usefixtures("compiled_once")
def test_a_run_goes_to_weights_and_biases_offline(tiny, run_directory, monkeypatch):
    pytest.importorskip("wandb", reason="needs the extra wandb")
    monkeypatch.setenv("WANDB_MODE", "offline")
    config = dataclasses.replace(tiny, seeds=2, log=LogConfig(epochs=2, episodes=1, wandb=True))
    train_run(config, run_directory)
    rows = records.read_rows(run_directory / "metrics.jsonl")
    files = sorted(run_directory.glob("wandb/offline-run-*/*.wandb"))
    assert [file.stem[-1] for file in files] == ["0", "1"]
    for seed, file in enumerate(files):
        own = [row for row in rows if row["seed"] == seed]
        until(lambda file=file, own=own: len(history(file)) == len(own))  # another process writes it
        assert [entry["mean_return"] for entry in history(file)] == [row["mean_return"] for row in own]
        assert [entry["_step"] for entry in history(file)] == [row["env_steps"] for row in own]
    before = records.read_json(run_directory / "wandb.json")
    time.sleep(1.1)  # wandb names its folders by the second
    train_run(dataclasses.replace(config, epochs=6), run_directory)
    assert records.read_json(run_directory / "wandb.json") == {**before, "epoch": 6}
    (later,) = set(run_directory.glob("wandb/offline-run-*-0/*.wandb")) - set(files)
    assert [entry["epoch"] for entry in history(later)] == [6]  # and nothing again


def until(holds: Callable[[], bool]) -> None:
    """Waits for a condition, at most 30 seconds."""
    end = time.monotonic() + 30
    while not holds() and time.monotonic() < end:
        time.sleep(0.1)


def history(file: Path) -> list[dict[str, float]]:
    """Reads the rows in an offline file of Weights & Biases, which has the format of LevelDB's log."""
    from wandb.proto.wandb_internal_pb2 import Record

    content, place, found, data = file.read_bytes(), 7, [], b""
    while place + 7 < len(content):
        size, kind = struct.unpack("<HB", content[place + 4 : place + 7])  # after a checksum
        data += content[place + 7 : place + 7 + size]
        place += 7 + size
        place += left if (left := 32768 - place % 32768) < 7 else 0  # no record begins in the last bytes of a block
        if kind in (1, 4):  # the whole of a record, or its last part
            record = Record.FromString(data)
            if record.WhichOneof("record_type") == "history":
                items = record.history.item
                found.append({item.key or "/".join(item.nested_key): json.loads(item.value_json) for item in items})
            data = b""
    return found


def test_weights_and_biases_without_an_account_are_one_line(tmp_path):
    """In a process of its own, as wandb reads its environment once."""
    pytest.importorskip("wandb", reason="needs the extra wandb")
    write_records(tmp_path / "run", {0: [{"vel-1": 1}]})
    environment = {name: value for name, value in os.environ.items() if not name.startswith("WANDB")}
    environment["NETRC"] = str(tmp_path / "netrc")
    command = [sys.executable, "-m", "ear_jax.cli.main", "log", "run", "--wandb"]
    streams = {"stdin": subprocess.DEVNULL, "capture_output": True, "text": True}
    done = subprocess.run(command, cwd=tmp_path, env=environment, timeout=120, **streams)
    assert done.returncode == 1
    assert re.fullmatch(r"ear: Weights & Biases cannot be used: No API key.*WANDB_MODE=offline.*\n", done.stderr)
