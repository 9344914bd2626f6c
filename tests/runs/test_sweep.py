"""Runs side by side: numbers as arguments of one program, trials like runs of their own, failures, continuation."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ear_jax.cli.main import main
from ear_jax.config import Config, flag
from ear_jax.embeddings.evaluate import evaluate
from ear_jax.errors import RunError, UsageError
from ear_jax.runs import checkpoint, loop, records, sweep
from ear_jax.runs.documents import rows_of
from ear_jax.runs.loop import Run, train_run, train_runs
from ear_jax.runs.side_by_side import differing, programs
from ear_jax.runs.trained import load, save
from tests.helpers.runs import last_state, leaves, tiny_config, words

pytestmark = pytest.mark.usefixtures("compiled_once")


def with_sac(config: Config, **changes: float) -> Config:
    return dataclasses.replace(config, sac=dataclasses.replace(config.sac, **changes))


def pair(where: Path, **changes: object) -> list[Run]:
    """Two runs of two seeds that differ in their step size and their noise; the second is a run of many tests."""
    config = tiny_config(seeds=2, **changes)
    trials = {"slow": with_sac(config, lr=1e-4, lte_noise=0.1), "fast": config}
    return [Run(trial, where / name) for name, trial in trials.items()]


def test_numbers_share_a_program_and_other_settings_have_one_each(tiny):
    lr, scaled, wide = with_sac(tiny, lr=1e-4), with_sac(tiny, return_scale=10.0), with_sac(tiny, batch_size=64)
    other_scale = with_sac(tiny, return_scale=5.0)
    assert programs([tiny, wide, lr, scaled, other_scale]) == [[0, 2], [1], [3, 4]]
    assert differing([tiny, tiny]) == {}
    two_seeds = [dataclasses.replace(config, seeds=2) for config in (tiny, lr)]
    np.testing.assert_array_equal(differing(two_seeds)["sac.lr"], np.float32([1e-3, 1e-3, 1e-4, 1e-4]))


def test_a_trial_is_the_run_that_it_would_be_alone(tmp_path):
    runs = pair(tmp_path)
    train_runs(runs)
    slow, fast = (leaves(last_state(run.directory, run.config).learner) for run in runs)
    alone = tmp_path / "alone"
    train_run(runs[1].config, alone)
    for together, apart in zip(fast, leaves(last_state(alone, runs[1].config).learner), strict=True):
        np.testing.assert_allclose(together, apart, rtol=2e-3, atol=2e-5)
    for place in (*(run.directory for run in runs), alone):
        rows = records.read_rows(place / "metrics.jsonl")
        assert [(row["seed"], row["epoch"]) for row in rows] == [(0, 2), (1, 2), (0, 4), (1, 4)]
    assert not all(np.allclose(one, other) for one, other in zip(slow, fast, strict=True))


def test_trials_continue_to_the_bit_and_from_the_newest_epoch_that_all_have(tmp_path):
    train_runs(pair(tmp_path / "whole"))
    train_runs(pair(tmp_path / "parts", epochs=2))
    train_runs(pair(tmp_path / "parts"))
    for whole, parts in zip(pair(tmp_path / "whole"), pair(tmp_path / "parts"), strict=True):
        states = [leaves(last_state(run.directory, run.config)) for run in (whole, parts)]
        assert all(np.array_equal(one, other) for one, other in zip(*states, strict=True))


def failing(*members: int):
    """Returns the rows of a block with losses of some members that are not finite."""

    def rows(*arguments) -> list[dict[str, object]]:
        return [
            {**row, "critic_loss": np.nan} if index in members else row for index, row in enumerate(rows_of(*arguments))
        ]

    return rows


def test_a_trial_that_fails_leaves_the_others(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(loop, "rows_of", failing(3))
    slow, fast = pair(tmp_path)
    train_runs([slow, fast])
    (warning,) = [line for line in capsys.readouterr().err.splitlines() if "failed" in line]
    assert "seed 1 failed: critic_loss is nan" in warning
    assert "the other runs go on" in warning
    assert [row["epoch"] for row in records.read_rows(slow.directory / "metrics.jsonl")] == [2, 2, 4, 4]
    assert records.read_rows(fast.directory / "metrics.jsonl") == []
    assert records.read_json(fast.directory / "failure.json")["seed"] == 1
    monkeypatch.setattr(loop, "rows_of", failing(0, 3))
    with pytest.raises(RunError, match="all runs failed"):
        train_runs(pair(tmp_path / "again"))
    with pytest.raises(RunError, match="all 2 runs failed, see"):
        train_runs(pair(tmp_path / "again"))


def test_a_trial_that_failed_keeps_its_last_good_policy_and_the_others_continue(tmp_path, monkeypatch):
    blocks = {"checkpoint": dataclasses.replace(tiny_config().checkpoint, blocks=1)}
    slow, fast = pair(tmp_path, epochs=2, **blocks)
    train_runs([slow, fast])
    monkeypatch.setattr(loop, "rows_of", failing(3))
    for epochs in (4, 6):
        train_runs(pair(tmp_path, epochs=epochs, **blocks))
    assert [max(checkpoint.steps(run.directory / checkpoint.FOLDER)) for run in (slow, fast)] == [6, 2]
    assert [row["epoch"] for row in records.read_rows(fast.directory / "metrics.jsonl")] == [2, 2]
    assert np.isfinite(evaluate(load(fast.directory), 1, 0)["mean_return"])


def test_a_trial_that_is_done_is_not_erased_for_one_whose_report_is_deleted(tmp_path, monkeypatch):
    monkeypatch.setattr(loop, "rows_of", failing(3))
    train_runs(pair(tmp_path))
    (tmp_path / "fast" / "failure.json").unlink()
    before = (tmp_path / "slow" / "metrics.jsonl").read_text()
    with pytest.raises(RunError, match=r"fast has no checkpoints, unlike .*slow that trained beside it"):
        train_runs(pair(tmp_path, epochs=6))
    assert (tmp_path / "slow" / "metrics.jsonl").read_text() == before


def test_a_policy_that_is_not_finite_is_refused(tmp_path):
    run = pair(tmp_path)[0]
    train_runs([run])
    trained = load(run.directory)
    spoilt = jax.tree.map(lambda leaf: leaf.at[0].set(jnp.nan), trained.policies)
    save(tmp_path / "spoilt.safetensors", dataclasses.replace(trained, policies=spoilt), [])
    with pytest.raises(RunError, match="not finite: its training diverged"):
        load(tmp_path / "spoilt.safetensors")


def test_a_program_that_fails_leaves_the_other_programs(tmp_path, capsys, monkeypatch):
    def rows(program, *arguments) -> list[dict[str, object]]:
        return (failing(0) if program.config.network.width == 9 else rows_of)(program, *arguments)

    monkeypatch.setattr(loop, "rows_of", rows)
    line = sweep_words(tmp_path / "sweep", "network.width", "9", "8")
    for said in ("the sweep goes on", "network.width=9 failed before, see"):
        assert main(line) == 0
        out, err = capsys.readouterr()
        assert said in err
        best, last = json.loads(out)["trials"]
        assert (best["failed"], last["failed"]) == (None, "critic_loss")
        assert best["return"] is not None


def test_a_trial_without_its_checkpoints_is_not_trained_anew(tmp_path):
    runs = pair(tmp_path, checkpoint=dataclasses.replace(tiny_config().checkpoint, blocks=1))
    train_runs(runs)
    (runs[0].directory / "checkpoints").rename(tmp_path / "lost")
    with pytest.raises((RunError, UsageError), match="no checkpoint"):
        train_runs([dataclasses.replace(run, config=dataclasses.replace(run.config, epochs=6)) for run in runs])
    assert len(records.read_rows(runs[1].directory / "metrics.jsonl")) == 4


def sweep_words(place: Path, setting: str, *values: str) -> list[str]:
    line = ["sweep", *words(tiny_config(epochs=2, seeds=2))[1:]]
    for name in (flag(setting), "--seed"):
        index = line.index(name)
        del line[index : index + 2]
    return [*line, "--vary", setting, *values, "--out", str(place), "--json"]


def test_the_command_trains_every_combination_and_tells_the_best_first(tmp_path, capsys):
    line = sweep_words(tmp_path / "sweep", "sac.lr", "1e-4", "3e-3")
    assert main(line) == 0
    document = json.loads(capsys.readouterr().out)
    returns = [trial["return"] for trial in document["trials"]]
    assert returns == sorted(returns, reverse=True)
    assert {trial["name"] for trial in document["trials"]} == {"sac.lr=1e-4", "sac.lr=3e-3"}
    for trial in document["trials"]:
        rows = records.read_rows(tmp_path / "sweep" / trial["name"] / "metrics.jsonl")
        assert trial["return"] == pytest.approx(np.mean([row["mean_return"] for row in rows]))
        assert trial["curve"][-1][:2] == [rows[-1]["updates"], rows[-1]["env_steps"]]
        assert trial["settings"] == {"sac.lr": float(trial["name"].partition("=")[2])}
    assert Path(document["figures"][0]).exists()
    assert main(line) == 0  # continues, and so shows the same
    assert json.loads(capsys.readouterr().out)["trials"] == document["trials"]
    assert main([*line[: line.index("3e-3")], "1e-2", *line[line.index("--out") :]]) == 2
    assert "other trials" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("vary", "complaint"),
    [
        ("", "name a setting to vary"),
        ("--vary", "at least one value"),
        ("--vary sac.lr 1e-3", "two values or more"),
        ("--vary sac.rl 1 2", "did you mean 'sac.lr'"),
        ("--vary seeds 1 2", "not possible"),
        ("--vary sac.lr 1e-3 1e-4 --sac.lr 1e-3", "given and varied"),
        ("--vary sac.lr 1e-3 0.001", "names a value twice"),
        ("--vary sac.lr 1e-3 2", "at most 1"),
        ("--vary sac.lr 1e-3 1e-4 --agent maml", "would change nothing"),
        ("--vary sac.lr 1e-3 1e-4 --vary sac.lr 1 2", "given twice"),
        ("--vary sac.lr 1e-3 1e-4 --on ray --hosts.count 2", "--on ray spreads runs over hosts by itself"),
    ],
)
def test_a_mistake_is_told_in_one_line(vary, complaint, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["sweep", "hopper-vel", *vary.split()]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert complaint in line
    assert not list(tmp_path.iterdir())


def test_a_sweep_is_not_written_over_something_else(tmp_path):
    (tmp_path / "note").write_text("mine")
    with pytest.raises(UsageError, match="neither empty nor a sweep"):
        sweep.begin(tmp_path, "hopper-vel", {"a": {"sac.lr": 1e-3}})


def test_a_sweep_that_was_killed_before_its_document_begins_again(tmp_path):
    (tmp_path / ".sweep.json.0a1b2c3d.part").touch()
    sweep.begin(tmp_path, "hopper-vel", {"a": {"sac.lr": 1e-3}})
    assert sweep.read_sweep(tmp_path)["trials"][0]["name"] == "a"


def test_a_sweep_whose_document_is_another_is_named(tmp_path):
    records.write_json(tmp_path / sweep.NAME, {"trials": []})
    with pytest.raises(RunError, match=r"sweep\.json cannot be read: it names no family or no trials"):
        sweep.begin(tmp_path, "hopper-vel", {"a": {"sac.lr": 1e-3}})
    records.write_json(tmp_path / sweep.NAME, {"family": "ant-dir", "trials": []})
    with pytest.raises(UsageError, match="holds a sweep of 0 other trials; use another --out"):
        sweep.begin(tmp_path, "hopper-vel", {"a": {"sac.lr": 1e-3}})
