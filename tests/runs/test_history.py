"""A run's past: no history is erased, documents that are lost come back from the steps, and a step is what it says."""

from __future__ import annotations

import errno
import json
import os
import shutil
from pathlib import Path

import jax.numpy as jnp
import pytest

from ear_jax.errors import RunError, UsageError
from ear_jax.runs import checkpoint, history, manifest, on_host, records, trained
from ear_jax.runs.loop import train_run
from tests.helpers.runs import finished_config, times

MORE = finished_config(epochs=30)


def remove(steps: Path) -> None:
    shutil.rmtree(steps)


def empty(steps: Path) -> None:
    for step in steps.iterdir():
        shutil.rmtree(step)


def unmount(steps: Path) -> None:
    shutil.rmtree(steps)
    steps.symlink_to("/nowhere/checkpoints")


@pytest.mark.parametrize("config", [MORE, finished_config()])
@pytest.mark.parametrize(
    ("lose", "complaint"),
    [
        (remove, "no checkpoint, though one was saved at epoch 6; nothing was changed: put them back"),
        (empty, "no checkpoint, though one was saved at epoch 6"),
        (unmount, "checkpoints is a link to /nowhere/checkpoints, which is not there"),
    ],
)
def test_rows_without_a_step_are_not_erased(lose, complaint, config, refusal, finished):
    lose(finished / "checkpoints")
    assert complaint in refusal(config)


@pytest.mark.parametrize("spoilt", [lambda text: text[:-1], lambda text: text.replace("\n", "\v", 1)])
def test_a_damaged_end_of_a_line_is_restored(spoilt, finished, capsys):
    log = finished / "metrics.jsonl"
    text = log.read_text()
    log.write_text(spoilt(text))
    train_run(finished_config(), finished)
    assert "metrics.jsonl is damaged in line" in capsys.readouterr().err
    assert log.read_text() == text


def test_so_it_is_for_runs_of_earlier_versions(refusal, finished):
    settings = records.read_run(finished)
    del settings[history.FIRST]
    (finished / "config.json").write_text(json.dumps(settings))
    shutil.rmtree(finished / "checkpoints")
    assert "it has rows of metrics until epoch 24, but no checkpoint; nothing was changed" in refusal(MORE)
    (finished / "config.json").write_text("")
    assert "config.json cannot be read: Expecting value" in refusal(MORE)


def test_a_run_killed_before_its_first_step_starts_anew(finished, monkeypatch):
    """Its rows are those of blocks that are trained again."""
    records.write_json(finished / "config.json", {**records.read_run(finished), history.FIRST: None})
    shutil.rmtree(finished / "checkpoints")
    monkeypatch.setattr(on_host, "compile_program", lambda *_: (_ for _ in ()).throw(RunError("it came to compiling")))
    with pytest.raises(RunError, match="it came to compiling"):
        train_run(MORE, finished)
    assert records.read_rows(finished / "metrics.jsonl") == []


@pytest.mark.parametrize("harm", ["missing", "emptied", "torn", "a list", "another number"])
def test_config_json_comes_back_from_the_newest_step(harm, finished, capsys):
    path = finished / "config.json"
    good, text = records.read_run(finished), path.read_text()
    harmed = {"emptied": "", "torn": text[:300], "a list": '{"config": []}', "another number": text.replace("16", "32")}
    path.unlink() if harm == "missing" else path.write_text(harmed[harm])
    assert trained.load(finished).epoch == 24
    said = capsys.readouterr().err
    assert said.startswith(f"warning: {path} ")
    assert said.endswith("`ear train` restores it from the checkpoint of epoch 24\n")
    train_run(finished_config(), finished)
    assert "its settings are those of the checkpoint of epoch 24" in capsys.readouterr().err
    assert records.read_run(finished) == good
    before = times(finished)
    train_run(finished_config(), finished)
    assert times(finished) == before


def test_without_config_json_and_steps_it_is_no_run(tmp_path):
    with pytest.raises(UsageError, match="is not a run directory"):
        trained.load(tmp_path)


def test_a_run_without_a_first_step_is_no_trained_run_yet(finished):
    records.write_json(finished / "config.json", {**records.read_run(finished), history.FIRST: None})
    shutil.rmtree(finished / "checkpoints")
    with pytest.raises(RunError, match="has no checkpoint yet; the same `ear train` command continues it"):
        trained.load(finished)


def test_whoever_asks_is_told_the_same_of_lost_checkpoints(finished):
    shutil.rmtree(finished / "checkpoints")
    for use in (lambda: trained.load(finished), lambda: train_run(MORE, finished)):
        with pytest.raises(RunError, match="has lost its checkpoints: it has rows of metrics until epoch 24"):
            use()


def test_a_finished_run_tells_of_no_later_epoch_than_its_last_step(finished):
    """Rows of blocks that were not saved before a kill, and a smaller number of epochs afterwards."""
    log = finished / "metrics.jsonl"
    before = log.read_text()
    row = records.read_rows(log)[-1]
    records.append_rows(log, [{**row, "epoch": 30}])
    train_run(finished_config(), finished)
    assert log.read_text() == before


def flip(path: Path, number: int) -> None:
    """Changes a digit in a line."""
    lines = path.read_text().splitlines(keepends=True)
    lines[number - 1] = lines[number - 1].replace('"mean_return": -', '"mean_return": -1')
    path.write_text("".join(lines))


@pytest.mark.parametrize("harm", ["a digit", "a line", "all"])
def test_rows_come_back_from_the_newest_step(harm, finished, capsys):
    path = finished / "metrics.jsonl"
    rows, text = records.read_rows(path), path.read_text()
    if harm == "a digit":
        flip(path, 5)
    elif harm == "a line":
        path.write_text("".join(text.splitlines(keepends=True)[:4] + text.splitlines(keepends=True)[5:]))
    else:
        path.unlink()
    train_run(finished_config(), finished)
    line = 1 if harm == "all" else 5
    assert (
        f"{path} is damaged in line {line}; its rows are those of the checkpoint of epoch 24" in capsys.readouterr().err
    )
    assert records.read_rows(path) == rows


def test_a_damaged_row_that_no_step_has_is_named_and_left(finished, capsys, compiled_once):
    """Steps of earlier versions hold no rows."""
    for step in (finished / "checkpoints").iterdir():
        (step / checkpoint.ROWS).unlink()
        manifest.write(step)
    path = finished / "metrics.jsonl"
    flip(path, 5)
    lines = path.read_text().splitlines()
    train_run(finished_config(epochs=26), finished)
    assert f"warning: {path} is damaged: line 5: it differs from its checksum; it is skipped" in capsys.readouterr().err
    assert path.read_text().splitlines()[: len(lines)] == lines
    with pytest.raises(RunError, match="line 5"):
        records.read_rows(path)


def swap(steps: Path) -> None:
    (steps / "18").rename(steps / "x")
    (steps / "24").rename(steps / "18")
    (steps / "x").rename(steps / "24")


def copy(steps: Path) -> None:
    shutil.copytree(steps / "6", steps / "30")


def of_another_run(steps: Path) -> None:
    about = records.read_json(steps / "24" / "about.json")
    records.write_json(steps / "24" / "about.json", {**about, "run": "another"})
    manifest.write(steps / "24")


@pytest.mark.parametrize(
    ("harm", "complaint", "left"),
    [
        (swap, "it is the checkpoint of epoch 18; going back to epoch 12", 12),
        (copy, "30 is damaged: it is the checkpoint of epoch 6; going back to epoch 24", 24),
        (of_another_run, "24 is damaged: it is the checkpoint of another run; going back to epoch 18", 18),
    ],
)
def test_a_step_is_what_its_name_says(harm, complaint, left, finished):
    harm(finished / "checkpoints")
    warnings: list[str] = []
    run = records.read_run(finished)["run"]
    assert checkpoint.newest(finished / "checkpoints", warnings.append, run=run).epoch == left
    assert complaint in "\n".join(warnings)


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"epoch": jnp.full(2, 1_000_000)}, "is not the state of a run at epoch 26: epoch is 1000000"),
        ({"epoch": jnp.full(2, -5)}, "epoch is -5"),
        ({"collected": jnp.array([28, 3])}, "collected is 3"),
        ({"replay": {"added": jnp.array([[60, -1], [60, 60]])}}, r"replay\.added is -1"),
    ],
)
def test_counters_that_make_no_sense_are_refused(change, complaint, tmp_path):
    state = {"epoch": jnp.full(2, 26), "collected": jnp.full(2, 28), "replay": {"added": jnp.full((2, 2), 60)}}
    checkpoint.save(tmp_path, 26, {**state, **change}, {})
    with pytest.raises(RunError, match=complaint):
        checkpoint.restore(checkpoint.newest(tmp_path, pytest.fail), state)


def stray(steps: Path, kind: str) -> None:
    if kind == "a link":
        (steps / ".26.part").symlink_to("/nowhere")
    elif kind == "a folder":
        (steps / ".x.old" / "in").mkdir(parents=True)
    elif kind == "a file in its place":
        (steps / "26").write_text("stray")
    else:
        (steps / ".x.part").write_text("stray")


@pytest.mark.parametrize("kind", ["a file", "a link", "a folder", "a file in its place"])
def test_stray_names_do_not_hinder_a_save(kind, finished):
    steps = finished / "checkpoints"
    stray(steps, kind)
    state = {"a": jnp.zeros(2)}
    checkpoint.save(steps, 26, state, {})
    assert checkpoint.newest(steps, pytest.fail).epoch == 26
    assert all(path.name.isdecimal() for path in steps.iterdir())


def test_what_cannot_be_removed_is_named(finished, monkeypatch, refusal):
    def refuse(path: Path) -> None:
        raise PermissionError(errno.EPERM, "Operation not permitted", str(path))

    (finished / "checkpoints" / ".26.part").mkdir()
    monkeypatch.setattr(checkpoint, "_remove", refuse)
    assert "cannot remove" in (said := refusal(MORE))
    assert said.endswith(".26.part: Operation not permitted")


def test_checkpoints_that_are_no_directory_are_refused(refusal, finished):
    shutil.rmtree(finished / "checkpoints")
    (finished / "checkpoints").write_text("stray")
    assert "checkpoints is not a directory that can be written; move it away" in refusal(MORE)


def test_a_reader_chooses_again_when_its_step_is_gone(finished, monkeypatch):
    """A process that trains saves a newer step and removes the one that was chosen."""
    restore, gone = checkpoint.restore, []

    def too_late(step, *arguments, **options):
        if not gone:
            shutil.copytree(finished / "checkpoints" / "18", finished / "checkpoints" / "gone")
            gone.append(step.epoch)
            shutil.rmtree(step.path)
        return restore(step, *arguments, **options)

    monkeypatch.setattr(checkpoint, "restore", too_late)
    assert trained.load(finished).epoch == 18
    assert gone == [24]


def test_a_step_that_goes_while_it_is_read_is_not_called_damaged(finished, monkeypatch):
    fault, steps = manifest.fault, finished / "checkpoints"

    def pruned(path):
        if path.name == "24" and path.exists():
            os.rename(path, steps / ".24.old")
        return fault(path)

    monkeypatch.setattr(manifest, "fault", pruned)
    assert checkpoint.newest(steps, pytest.fail).epoch == 18
