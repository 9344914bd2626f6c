"""Runs that are refused in one line, before anything is compiled or written, and the dry run."""

from __future__ import annotations

import dataclasses
import os
import re
import shutil
from pathlib import Path

import pytest

from ear_jax.cli.main import main
from ear_jax.errors import RunError, UsageError
from ear_jax.runs import checkpoint, on_host
from ear_jax.runs.documents import differences
from ear_jax.runs.loop import train_run
from ear_jax.runs.trained import load
from ear_jax.runs.training import make_program
from ear_jax.tasks import Task, task_set
from tests.helpers.runs import finished_config, last_state, words

MORE = finished_config(epochs=30)


def test_two_writers(refusal, finished):
    from ear_jax.runs.lock import lock_directory

    with lock_directory(finished, pytest.fail):
        assert f"{finished} is in use by process {os.getpid()} on " in refusal(MORE)


def test_changed_settings(refusal):
    changed = dataclasses.replace(MORE, sac=dataclasses.replace(MORE.sac, lr=0.5), seed=7)
    assert "other settings: seed was 0, is 7; sac.lr was 0.001, is 0.5; use another --out" in refusal(changed)


def test_types_and_paths_as_a_program_gives_them(finished, capsys):
    with pytest.raises(UsageError, match="the setting epochs is '3'; it must be of type int"):
        train_run(dataclasses.replace(MORE, epochs="3"), finished)
    with pytest.raises(UsageError, match=r"the setting tasks is \(1\.0, 3\.0\); it must be of type tuple"):
        train_run(dataclasses.replace(MORE, tasks=(1.0, 3.0)), finished)
    train_run(finished_config(), str(finished))
    assert "is finished" in capsys.readouterr().err
    assert load(str(finished)).epoch == 24


def test_another_task_set_under_the_same_name(refusal, monkeypatch):
    """It happens when a family's own file has changed since."""
    from ear_jax.envs.halfcheetah_vel import HalfCheetahVel

    parse, params = HalfCheetahVel.parse_task, {"velocity": 9.0}
    other = lambda self, text: dataclasses.replace(parse(self, text), params=params)  # noqa: E731
    monkeypatch.setattr(HalfCheetahVel, "parse_task", other)
    said = refusal(MORE)
    assert "was trained on other tasks: {'name': 'vel-1', 'params': {'velocity': 1.0}, 'target': 1.0} is now" in said


@pytest.mark.parametrize(
    ("setting", "value", "complaint"),
    [
        ("family", "hopper-vel", "family was hopper-vel, is halfcheetah-vel"),
        ("network", {"width": 32}, "network.width was 32, is 16"),
    ],
)
def test_a_checkpoint_of_another_family_or_width(setting, value, complaint, refusal, finished):
    """The checkpoint was copied whole from another run's directory."""
    state = last_state(finished, finished_config())
    step = checkpoint.newest(finished / "checkpoints", pytest.fail)
    config = step.about["config"]
    other = {**config[setting], **value} if isinstance(value, dict) else value
    checkpoint.save(finished / "checkpoints", 26, state, {**step.about, "config": {**config, setting: other}})
    assert f"26 holds a run with other settings: {complaint}" in refusal(MORE)


def test_a_checkpoint_whose_arrays_are_anothers(finished):
    """The checkpoint claims to be this run's."""
    wide = dataclasses.replace(MORE, network=dataclasses.replace(MORE.network, width=32))
    with pytest.raises(RunError, match=r"24 does not fit this run: .* is float32 \[2, .*16\], not .*32\]"):
        last_state(finished, wide)


def test_a_planted_pickle(refusal, finished):
    for step in (finished / "checkpoints").iterdir():
        shutil.rmtree(step)
    (finished / "checkpoints" / "24").mkdir()
    (finished / "checkpoints" / "24" / "state.pkl").write_bytes(b"cos\nsystem\n(S'true'\ntR.")
    assert "24 is damaged: SHA256SUMS is missing; no good checkpoint is left" in refusal(MORE)


def test_a_directory_that_cannot_be_written(refusal, finished, monkeypatch):
    """The tests may run as root, who can write everywhere, so `os.access` is patched."""
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path) != finished)
    assert refusal(MORE) == f"cannot write in {finished}"


def test_what_a_process_left_that_was_killed_at_once_is_no_obstacle(run_directory, monkeypatch):
    run_directory.mkdir()
    for name in ("lock", "config.json.part"):
        (run_directory / name).touch()
    monkeypatch.setattr(on_host, "compile_program", lambda *_: (_ for _ in ()).throw(RunError("it came to compiling")))
    with pytest.raises(RunError, match="it came to compiling"):
        train_run(finished_config(), run_directory)


def test_a_dry_run_tells_and_writes_nothing(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main([*words(finished_config(seeds=1)), "--dry-run"]) == 0
    said = capsys.readouterr().out
    assert "  sac.lr 0.001\n" in said
    assert (
        "memory: 0.95 GB (replay 0.00 GB, networks and optimisers 0.00 GB, an epoch 0.00 GB, compiling 0.95 GB, "
        in said
    )
    assert re.search(
        r"time here: \d+ s to compile, [\d.]+ s per epoch, .* every 2 epochs; 24 epochs take \d+ minutes\n", said
    )
    assert list(tmp_path.iterdir()) == []


def test_other_versions_and_engines_are_told_of(finished):
    program, about = make_program(finished_config()), checkpoint.newest(finished / "checkpoints", pytest.fail).about
    assert differences(about, program) == []
    jax = about["versions"]["jax"]
    other = {**about, "engine": "mjx", "versions": {**about["versions"], "jax": "0.1"}}
    assert differences(other, program) == ["engine was mjx, is native", f"jax was 0.1, is {jax}"]


def test_the_fingerprint_is_of_names_targets_and_numbers_in_order():
    one, two = (Task(name, target, {"velocity": target}) for name, target in (("a", 1.0), ("b", 2.0)))
    prints = {task_set(tasks).fingerprint for tasks in ([one, two], [two, one], [one], [one, two])}
    assert len(prints) == 3
    other = dataclasses.replace(one, params={"velocity": 1.5})
    assert task_set([other]).fingerprint != task_set([one]).fingerprint
    assert make_program(finished_config()).tasks.fingerprint == make_program(finished_config(seeds=1)).tasks.fingerprint
