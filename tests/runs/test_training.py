"""The training program's contract: traced once, independent seeds, and a stop that leaves no trace."""

from __future__ import annotations

import dataclasses
import json
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from unittest.mock import Mock

import jax
import numpy as np
import pytest

from ear_jax.errors import RunError, UsageError
from ear_jax.presets import preset_config
from ear_jax.runs import checkpoint, loop, on_host, records, training
from ear_jax.runs.compiled import compile_program
from ear_jax.runs.leaves import named_leaves
from ear_jax.runs.loop import train_run
from tests.helpers.runs import last_state, leaves, state_after, tiny_config

pytestmark = pytest.mark.usefixtures("compiled_once")


def test_each_half_of_an_epoch_is_traced_once_in_a_run(tiny, run_directory, monkeypatch):
    monkeypatch.setattr(on_host, "compile_program", compile_program)  # not the shared one
    halves = [Mock(wraps=getattr(training, name)) for name in ("collect", "learn")]
    monkeypatch.setattr(training, "collect", halves[0])
    monkeypatch.setattr(training, "learn", halves[1])
    train_run(dataclasses.replace(tiny, epochs=7), run_directory)  # blocks of 2, and a last of 1
    assert len(records.read_rows(run_directory / "metrics.jsonl")) == 4
    assert [half.call_count for half in halves] == [1, 1]


def test_equal_seeds_agree_bit_for_bit_and_different_seeds_differ(tiny):
    for one, two in zip(leaves(state_after(tiny, 4)), leaves(state_after(tiny, 4)), strict=True):
        np.testing.assert_array_equal(one, two)
    both = state_after(dataclasses.replace(tiny, seeds=2), 2)
    policy = jax.tree.leaves(both.learner.policy)
    assert all((leaf[0] != leaf[1]).any() for leaf in policy if np.asarray(leaf[0]).any())


def test_a_seed_of_several_equals_that_seed_alone(tiny):
    several = state_after(dataclasses.replace(tiny, seeds=2), 2)
    alone = state_after(dataclasses.replace(tiny, seed=1), 2)
    for one, two in zip(leaves(several.learner), leaves(alone.learner), strict=True):
        np.testing.assert_allclose(one[1], two[0], rtol=2e-3, atol=2e-5)


def test_stopping_and_continuing_equals_never_stopping(tiny, tmp_path):
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    train_run(tiny, whole)
    train_run(dataclasses.replace(tiny, epochs=2), parts)
    train_run(tiny, parts)
    for one, two in zip(*(leaves(last_state(place, tiny)) for place in (whole, parts)), strict=True):
        np.testing.assert_array_equal(one, two)
    rows = [records.read_rows(place / "metrics.jsonl") for place in (whole, parts)]
    for row in (*rows[0], *rows[1]):
        del row["seconds"]
    assert rows[0] == rows[1]
    assert records.read_run(parts)["config"] == records.read_run(whole)["config"]


def test_rows_past_the_checkpoint_are_written_once(tiny, run_directory):
    train_run(dataclasses.replace(tiny, epochs=2), run_directory)
    log = run_directory / "metrics.jsonl"
    row = records.read_rows(log)[0]
    log.write_text(json.dumps(row) + "\n" + json.dumps({**row, "epoch": 4}) + "\n" + '{"epoch": 4, "to')
    train_run(tiny, run_directory)
    assert [row["epoch"] for row in records.read_rows(log)] == [2, 4]


def test_finished_run_is_left_alone(tiny, run_directory, capsys):
    train_run(tiny, run_directory)
    before = {path: path.stat().st_mtime_ns for path in run_directory.rglob("*") if path.name != "metrics.jsonl"}
    train_run(tiny, run_directory)
    assert {path: path.stat().st_mtime_ns for path in before} == before
    assert "is finished" in capsys.readouterr().err


def test_what_another_process_did_until_just_now_is_kept(tiny, run_directory, monkeypatch):
    train_run(dataclasses.replace(tiny, epochs=2), run_directory)
    lock, log = loop.lock_directory, run_directory / "metrics.jsonl"

    @contextmanager
    def lock_late(*words):
        monkeypatch.setattr(loop, "lock_directory", lock)
        train_run(tiny, run_directory)  # to the end, after this process has read the run and before it has the lock
        seen.append(log.read_text())
        with lock(*words):
            yield

    seen: list[str] = []
    monkeypatch.setattr(loop, "lock_directory", lock_late)
    train_run(tiny, run_directory)
    assert seen == [log.read_text()]
    assert [row["epoch"] for row in records.read_rows(log)] == [2, 4]


def test_minutes_stop_a_run_and_more_continue_it(tiny, run_directory):
    short = dataclasses.replace(tiny, minutes=0.0001, epochs=6)
    # Setting up takes longer than that: nothing is trained, and the directory can be continued.
    with pytest.raises(RunError, match=r"--minutes 0.0001 ran out before training started; raise it to continue"):
        train_run(short, run_directory)
    assert records.read_rows(run_directory / "metrics.jsonl") == []
    train_run(dataclasses.replace(short, minutes=None), run_directory)
    assert records.read_rows(run_directory / "metrics.jsonl")[-1]["epoch"] == 6


def test_changed_settings_are_refused_with_the_difference(tiny, run_directory):
    train_run(tiny, run_directory)
    changed = dataclasses.replace(tiny, sac=dataclasses.replace(tiny.sac, lr=0.5))
    with pytest.raises(UsageError, match=r"sac\.lr was 0\.001, is 0\.5"):
        train_run(changed, run_directory)


def test_counts_in_the_metrics(tiny, run_directory):
    train_run(dataclasses.replace(tiny, seeds=2), run_directory)
    rows = records.read_rows(run_directory / "metrics.jsonl")
    assert [(row["seed"], row["epoch"]) for row in rows] == [(0, 2), (1, 2), (0, 4), (1, 4)]
    # 2 tasks × 2 envs × 5 steps an epoch, 2 epochs of pretraining; 4 updates an epoch.
    assert [(row["env_steps"], row["updates"]) for row in rows[::2]] == [(80, 8), (120, 16)]
    assert set(rows[0]["returns"]) == {"vel-1", "vel-3"}
    assert rows[0]["invalid_steps"] == 0


def test_restoring_only_the_policy_reads_nothing_else(tiny, run_directory, monkeypatch):
    from ear_jax.runs.trained import load

    train_run(tiny, run_directory)
    restored, restore = [], checkpoint.restore

    def note(step, like, **options):
        restored.extend(named_leaves(like))
        return restore(step, like, **options)

    monkeypatch.setattr(checkpoint, "restore", note)
    trained = load(run_directory)
    assert trained.epoch == 4
    assert len(restored) == len(jax.tree.leaves(trained.policies)) + 1
    assert {name.split(".")[0] for name in restored} == {"learner", "collected"}
    for old, new in zip(leaves(last_state(run_directory, tiny).learner.policy), leaves(trained.policies), strict=True):
        np.testing.assert_array_equal(old, new)


@pytest.mark.slow
def test_fifty_short_runs_of_the_callback_engine_do_not_deadlock():
    """Each runs in a process of its own, where threads start cold; a deadlock would run into the timeout."""
    code = (
        "import sys; sys.path.insert(0, sys.argv[1]); import jax; from tests.helpers import runs;"
        "jax.block_until_ready(runs.state_after(runs.tiny_config(), 2))"
    )
    for _ in range(50):
        subprocess.run([sys.executable, "-c", code, str(Path(__file__).parents[2])], check=True, timeout=120)


@pytest.mark.parametrize("runs", [10, pytest.param(50, marks=pytest.mark.slow)])
def test_many_runs_in_one_process_do_not_deadlock(runs):
    for _ in range(runs):
        assert int(state_after(tiny_config(), 1).epoch[0]) == 1


def test_a_run_trains_in_any_thread_of_a_program(tiny, run_directory):
    """Signals are the main thread's: a run elsewhere records none, and a program's handlers stay."""
    before = signal.getsignal(signal.SIGINT)
    with ThreadPoolExecutor() as pool:
        pool.submit(train_run, tiny, run_directory).result()
    assert records.read_rows(run_directory / "metrics.jsonl")[-1]["epoch"] == tiny.epochs
    assert signal.getsignal(signal.SIGINT) is before


def test_a_programs_family_can_have_other_options_and_keeps_its_own():
    program = training.make_program(preset_config("ant-dir", "fast"))
    other = training.family_with(program, {"lateral_weight": 0.5})
    assert (other.lateral_weight, program.family.lateral_weight) == (0.5, 0)
    assert training.family_with(program, {}) is program.family
