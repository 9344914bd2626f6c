"""Commands without what takes long in them, for tests that run many: words are read and runs are loaded for real."""

from __future__ import annotations

import time
from collections.abc import Sequence

import pytest

from ear_jax.cli.main import main
from ear_jax.errors import RunError

COMPUTES = (
    "ear_jax.embeddings.evaluate.evaluate",
    "ear_jax.embeddings.evaluate.evaluate_code",
    "ear_jax.embeddings.interpolate.interpolate",
    "ear_jax.embeddings.interpolate.play_blends",
    "ear_jax.embeddings.compose.compose",
    "ear_jax.embeddings.adapt.adapt",
    "ear_jax.embeddings.map.play_maps",
    "ear_jax.embeddings.rewards.adapt_to_rewards",
    "ear_jax.embeddings.imagine.imagine",
    "ear_jax.embeddings.survey.find_survey",
    "ear_jax.embeddings.follow.follow_course",
    "ear_jax.embeddings.lse.lse",
    "ear_jax.embeddings.trajectory.follow",
    "ear_jax.rendering.explore.play_sphere",
    "ear_jax.cli.sweep.print_plan",
    "ear_jax.rendering.live.wasm.find",
    "ear_jax.runs.estimate.times",
)
TRAINS = ("ear_jax.runs.loop.train_run", "ear_jax.runs.loop.train_runs")
SECONDS = 10  # for one command line


def stub(monkeypatch: pytest.MonkeyPatch, names: Sequence[str]) -> None:
    """Replaces functions by one that ends the command: it came as far as computing."""

    def compute(*_: object, **__: object) -> None:
        raise RunError("computed")

    for name in names:
        monkeypatch.setattr(name, compute)


def check(words: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """Runs a command line, checks that it ends soon and in at most one line, and returns that line."""
    began = time.process_time()  # of this process, as a machine may be busy
    code = main(words)
    assert time.process_time() - began < SECONDS, words
    assert code in (0, 1, 2), words
    errors = [line for line in capsys.readouterr().err.splitlines() if line.startswith("ear: ")]
    assert len(errors) == (code != 0), words
    return errors[0] if errors else ""
