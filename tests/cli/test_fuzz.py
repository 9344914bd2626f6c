"""Random command lines never end in a traceback, never hang, and say in one line what is wrong."""

from __future__ import annotations

import functools
import random
import time
from pathlib import Path

import pytest

from ear_jax.cli.main import main
from ear_jax.errors import RunError
from ear_jax.process import terminal
from ear_jax.runs import trained
from tests.helpers.command_lines import command_line, make_places

# What takes long or writes much: everything before it, and the reading of a run, is the real thing.
COMPUTES = (
    "ear_jax.embeddings.evaluate.evaluate",
    "ear_jax.embeddings.evaluate.evaluate_code",
    "ear_jax.embeddings.interpolate.interpolate",
    "ear_jax.embeddings.interpolate.play_blends",
    "ear_jax.embeddings.compose.compose",
    "ear_jax.embeddings.adapt.adapt",
    "ear_jax.embeddings.map.survey",
    "ear_jax.embeddings.lse.lse",
    "ear_jax.embeddings.trajectory.follow",
    "ear_jax.rendering.explore.play_sphere",
    "ear_jax.runs.loop.train_run",
    "ear_jax.runs.loop.train_runs",
    "ear_jax.cli.sweep.print_plan",
    "ear_jax.rendering.live.wasm.find",
    "ear_jax.runs.estimate.times",
    "ear_jax.envs.make_family",
    "ear_jax.runs.trained.save",
)
SECONDS = 10  # for one command line
load = functools.cache(trained.load)


@pytest.fixture
def stubbed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def compute(*_: object, **__: object) -> None:
        raise RunError("computed")

    for name in COMPUTES:
        monkeypatch.setattr(name, compute)
    monkeypatch.setattr("ear_jax.cli.showing.show", compute)
    monkeypatch.setattr(trained, "load", load)
    monkeypatch.setattr("ear_jax.process.environment.problems", list)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    make_places(tmp_path)


def check(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    """Runs a command line and checks how it ends."""
    began = time.perf_counter()
    code = main(words)
    assert time.perf_counter() - began < SECONDS, words
    assert code in (0, 1, 2), words
    errors = [line for line in capsys.readouterr().err.splitlines() if line.startswith("ear: ")]
    assert len(errors) == (code != 0), words


@pytest.mark.parametrize("seed", [*range(4), *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(4, 44))])
def test_a_random_command_line_ends_in_one_line(seed, stubbed, capsys):
    assert terminal.console.file is not None
    dice = random.Random(seed)
    for _ in range(25):
        check(command_line(dice), capsys)
