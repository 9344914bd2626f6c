"""Random command lines never end in a traceback, never hang, and say in one line what is wrong."""

from __future__ import annotations

import functools
import random
from pathlib import Path

import pytest

from ear_jax.process import terminal
from ear_jax.runs import trained
from tests.helpers.command_lines import command_line, make_places
from tests.helpers.stubs import COMPUTES, TRAINS, check, stub

ALSO = ("ear_jax.envs.make_family", "ear_jax.runs.trained.save", "ear_jax.cli.showing.show")
load = functools.cache(trained.load)


@pytest.fixture
def stubbed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stub(monkeypatch, (*COMPUTES, *TRAINS, *ALSO))
    monkeypatch.setattr(trained, "load", load)
    monkeypatch.setattr("ear_jax.process.environment.problems", list)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    make_places(tmp_path)


@pytest.mark.parametrize("seed", [*range(4), *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(4, 44))])
def test_a_random_command_line_ends_in_one_line(seed, stubbed, capsys):
    assert terminal.console.file is not None
    dice = random.Random(seed)
    for _ in range(25):
        check(command_line(dice), capsys)
