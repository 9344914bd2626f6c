"""The last words of training: a summary, the curve in one line, and commands that work as they stand."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path

import pytest

from ear_jax.cli import train
from ear_jax.cli.closing import program, say_next, say_summary, sparkline
from ear_jax.cli.main import COMMANDS
from ear_jax.runs import records
from tests.helpers.runs import tiny_config


def test_a_curve_is_drawn_in_one_line():
    assert sparkline([0, 1, 2, 3, 4, 5, 6, 7], 60) == "▁▂▃▄▅▆▇█"
    assert sparkline([0, 2, 10, 12, 4, 6], 3) == "▁█▄"
    assert sparkline([5.0], 60) == "▁"
    assert len(sparkline(list(range(1000)), 40)) == 40


def test_the_summary_is_the_mean_over_seeds(capsys):
    rows = [
        {
            "seed": seed,
            "epoch": epoch,
            "env_steps": 1000 * epoch,
            "updates": 10 * epoch,
            "seconds": 60.0 * epoch,
            "mean_return": mean,
            "returns": {"vel-1": mean + 1, "vel-3": mean - 1},
        }
        for seed, epoch, mean in ((0, 2, -30.0), (1, 2, -10.0), (0, 4, -3.0), (1, 4, -1.0), (0, 6, -4.0), (1, 6, -2.0))
    ]
    say_summary(Path("runs/x"), rows)
    assert capsys.readouterr().err.splitlines()[1:] == [
        "runs/x: 6 epochs, 6,000 env steps and 60 updates per seed in 6 minutes",
        "return: -20.0 at epoch 2, -3.0 at epoch 6, the mean of 2 seeds",
        "        ▁██",
        "best task vel-1: -2.0; worst vel-3: -4.0",
    ]


def test_steps_that_were_not_finite_are_told(capsys):
    row = {"seed": 0, "env_steps": 1, "updates": 1, "seconds": 1.0, "mean_return": 0.0, "returns": {"a": 0.0}}
    say_summary(Path("runs/x"), [{**row, "epoch": epoch, "invalid_steps": lost} for epoch, lost in ((1, 16.1), (2, 0))])
    assert "warning: up to 16.1 steps of an epoch had a reward" in capsys.readouterr().err


def test_commands_name_the_program_as_it_can_be_typed_here(tmp_path, monkeypatch):
    ear = tmp_path / ".venv" / "bin" / "ear"
    ear.parent.mkdir(parents=True)
    ear.touch(mode=0o755)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [str(ear)])
    monkeypatch.setenv("PATH", "/usr/bin:/bin")
    assert program() == ".venv/bin/ear"
    monkeypatch.setenv("PATH", str(ear.parent))
    assert program() == "ear"
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    monkeypatch.setenv("PATH", "/usr/bin:/bin")
    assert program() == str(ear)
    monkeypatch.setattr(sys, "argv", ["/site-packages/ear_jax/cli/main.py"])
    monkeypatch.setattr(sys, "executable", "/opt/a b/python")
    assert program() == "'/opt/a b/python' -m ear_jax.cli.main"


@pytest.mark.parametrize("name", ["run", "my run", "L\xe4ufe's"])
def test_training_proposes_commands_that_the_shell_reads_as_they_stand(name, tmp_path, monkeypatch, capsys):
    run = tmp_path / name
    row = {"seed": 0, "epoch": 2, "env_steps": 1, "updates": 1, "seconds": 1.0, "mean_return": 0.0}
    run.mkdir()
    records.append_rows(run / "metrics.jsonl", [{**row, "returns": {"vel 1": 0.0}}])
    monkeypatch.setattr("ear_jax.runs.loop.train_run", lambda config, directory: None)
    monkeypatch.setattr(train, "draw_curves", lambda directory: None)
    train.train(tiny_config(), run)
    proposed = [line for line in capsys.readouterr().err.splitlines() if line.startswith("  ear ")]
    assert len(proposed) == 3
    for line in proposed:
        words = shlex.split(line)
        assert words[1] in COMMANDS
        assert words[2] == str(run)


def test_nothing_is_proposed_without_a_purpose(capsys):
    say_next(("doctor", "what is lacking"))
    assert capsys.readouterr().err.splitlines() == ["", "Next:", "  ear doctor  what is lacking"]
