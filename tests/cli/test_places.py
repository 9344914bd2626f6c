"""Results are shown whatever becomes of their files, and what cannot be held by memory or disk is refused at once."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from ear_jax.cli.main import main
from ear_jax.errors import UsageError
from ear_jax.runs.directory import check_place
from ear_jax.runs.trained import load


def test_an_evaluation_that_cannot_be_kept_is_shown(finished, capsys):
    (finished / "evaluation_episodes-2.json" / "in the way").mkdir(parents=True)
    assert main(["evaluate", str(finished), "--episodes", "2"]) == 0
    streams = capsys.readouterr()
    assert "mean return" in streams.out
    assert "vel-3" in streams.out
    assert f"warning: these results are not kept: cannot write {finished}/evaluation_episodes-2.json" in streams.err


TOO_MUCH = (
    "evaluate {} --episodes 100000000",
    "evaluate {} --lte 1 0 0 --episodes 10000000000",
    "interpolate {} --between 1 3 --episodes 100000000",
    "interpolate {} --all-pairs --beta 0.5 --episodes 1000000000000",
    "compose {} --between 1 3 --steps 1000000000000",
    "adapt {} --target 2 --samples 1000000000000",
    "adapt {} --target 2 --elites 1000000000000",
    "adapt {} --target 2 --episodes 1000000000000",
    "adapt {} --target 2 --epochs 1000000000000000",
    "map {} --places 1000000000000",
    "map {} --episodes 10000000000",
    "explore {} --places 1000000000000",
    "explore {} --replay --steps 1000000000000000",
    "render {} --task 1 --steps 1000000000000",
    "train halfcheetah-vel --log.episodes 2000000000",
    "train halfcheetah-vel --log.episodes 100000000",
    "train halfcheetah-vel --sac.updates 2000000000",
    "train halfcheetah-vel --seeds 1000000000",
)


def test_counts_that_do_not_fit_in_memory_are_refused_with_the_sizes(finished, monkeypatch, capsys):
    monkeypatch.chdir(finished)
    for words in TOO_MUCH:
        assert main(words.format(finished).split()) == 1, words
        said = capsys.readouterr().err.splitlines()[-1]
        assert said.startswith("ear: "), words
        assert "GB of memory" in said, words
        assert "is free" in said, words
    assert not Path("runs").exists()


def test_a_place_that_is_not_utf8_is_refused_before_the_work(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    name = os.fsdecode(b"runs/L\xe4ufe")
    assert main(["train", "halfcheetah-vel", "--out", name]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert r"runs/L\udce4ufe' is not UTF-8" in said
    assert list(tmp_path.iterdir()) == []
    os.mkdir(b"L\xe4ufe")
    with pytest.raises(UsageError, match="is not UTF-8"):
        load(Path(os.fsdecode(b"L\xe4ufe")))
    monkeypatch.chdir(tmp_path / os.fsdecode(b"L\xe4ufe"))
    with pytest.raises(UsageError, match="is not UTF-8"):
        check_place(Path("run"))


def test_a_path_too_long_for_the_files_of_a_run_is_refused(tmp_path):
    with pytest.raises(UsageError, match=r"has \d+ bytes, too many"):
        check_place(tmp_path.joinpath(*(["d" * 200] * 18)))


@pytest.mark.parametrize("words", ["explore {} --replay", "render {} --task 1", "adapt {} --target 2 --save trot"])
def test_a_command_whose_result_is_a_file_asks_for_the_place_first(words, finished, monkeypatch, capsys):
    monkeypatch.setattr(os, "access", lambda *_: False)  # as for a user who may not write there
    for work in ("ear_jax.rendering.explore.play_sphere", "ear_jax.embeddings.trajectory.follow"):
        monkeypatch.setattr(work, lambda *_: pytest.fail("it worked first"))
    assert main(words.format(finished).split()) == 1
    assert capsys.readouterr().err.endswith(f"ear: cannot write in {finished}\n")
