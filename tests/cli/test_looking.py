"""`ear plot` and `ear compare`: figures and documents of runs that exist, without JAX."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from ear_jax.cli.main import main
from ear_jax.cli.train import draw_curves
from ear_jax.figures.train import draw_train
from tests.helpers.records_of import write_records


@pytest.fixture
def runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for seed in range(2):
        write_records(tmp_path / f"ear-seed{seed}", {seed: [{"vel-1": seed + step} for step in range(3)]})
    write_records(tmp_path / "onehot-seeds0-1", {seed: [{"vel-1": -1}] * 2 for seed in range(2)}, agent="onehot")
    return tmp_path


def test_runs_are_plotted_with_seeds_as_bands(runs, capsys):
    words = ["plot", "ear-seed0", "ear-seed1", "onehot-seeds0-1", "--metric", "vel-1", "--by", "minutes"]
    assert main([*words, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert [(curve["name"], curve["seeds"]) for curve in document["curves"]] == [("ear", 2), ("onehot", 2)]
    png, svg = (runs / file for file in document["figures"])
    assert png.read_bytes().startswith(b"\x89PNG")
    assert "minutes" in png.name
    text = svg.read_text()
    assert "<svg" in text
    assert "wall time (min)" in text  # in a comment, as text is drawn as paths
    assert main(words) == 0
    assert svg.read_text() == text


def test_figures_of_other_runs_have_other_names(runs, capsys):
    (runs / "old").mkdir()
    write_records(runs / "old" / "ear-seed0", {0: [{"vel-1": 1}]})
    files = set()
    for shown in (["ear-seed0"], ["ear-seed0", "ear-seed1"], ["old/ear-seed0"]):
        assert main(["plot", *shown, "--json"]) == 0
        files |= set(json.loads(capsys.readouterr().out)["figures"])
    assert len(files) == 6
    for theirs in ("ear-seed0", "old/ear-seed0"):
        assert main(["compare", "ear-seed1", theirs]) == 0
    assert len(list((runs / "plots").glob("ear-seed1_against_ear-seed0_*.png"))) == 2


def test_what_is_no_run_among_others_is_left_out(runs, capsys):
    (runs / "pretrained-hopper-vel").mkdir()
    (runs / "page.html").touch()
    assert main(["plot", *sorted(path.name for path in runs.iterdir()), "--json"]) == 0
    streams = capsys.readouterr()
    assert len(json.loads(streams.out)["curves"]) == 2
    assert [line.split()[:3] for line in streams.err.splitlines()] == [
        ["left", "out:", "page.html"],
        ["left", "out:", "pretrained-hopper-vel"],
    ]
    assert main(["plot", "ear-seed0", "eer-seed1"]) == 2
    assert "eer-seed1 is not a run directory" in capsys.readouterr().err


def test_two_groups_are_compared(runs, capsys):
    words = ["compare", "ear-seed0", "ear-seed1", "--against", "onehot-seeds0-1"]
    assert main([*words, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["probability_of_improvement"]["value"] == 1.0
    assert (runs / document["figures"][0]).stat().st_size > 5_000
    assert main(words) == 0
    assert "a seed of ear beats a seed of onehot: probability 1.00 [1.00, 1.00]" in " ".join(
        capsys.readouterr().out.split()
    )


@pytest.mark.parametrize("as_json", [[], ["--json"]])
def test_a_comparison_whose_figure_cannot_be_written_is_shown(as_json, runs, capsys):
    (runs / "plots").touch()
    assert main(["compare", "ear-seed0", "onehot-seeds0-1", *as_json]) == 0
    streams = capsys.readouterr()
    assert json.loads(streams.out)["figures"] == [] if as_json else "beats a seed of" in streams.out
    assert streams.err.startswith("warning: these results are not kept: cannot write plots")


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        ("plot", "name at least one run"),
        ("plot nowhere", "not a run directory"),
        ("plot ear-seed0 --metric entropi", "did you mean 'entropy'"),
        ("plot ear-seed0 --by epoch", "--by takes updates, steps or minutes"),
        ("plot ear-seed0 --out plot.bmp", "must end in .png, .svg or .pdf"),
        ("compare", "give two runs"),
        ("compare ear-seed0", "give two runs"),
        ("compare ear-seed0 ear-seed0", "is given twice"),
        ("log ear-seed0", "--tensorboard, --wandb or both"),
        ("log nowhere --tensorboard", "not a run directory"),
    ],
)
def test_mistakes_are_one_line_and_write_nothing(words, complaint, runs, capsys):
    assert main(words.split()) == 2
    error = capsys.readouterr().err
    assert complaint in error
    assert error.count("\n") == 1
    assert not (runs / "plots").exists()


def test_a_run_is_drawn_once_for_its_last_row(runs):
    run = runs / "ear-seed0"
    (picture,) = draw_train(run)
    assert picture == run / "figures" / "training.png"
    assert draw_train(run) == []
    picture.unlink()
    assert draw_train(run) == [picture]


def test_curves_that_cannot_be_drawn_are_a_warning(runs, capsys):
    """A run that trained for hours does not fail for a picture."""
    (runs / "ear-seed0" / "figures").touch()
    draw_curves(Path("ear-seed0"))
    error = capsys.readouterr().err
    assert error.startswith("warning: the training curves were not drawn: cannot write ear-seed0/figures")
    assert error.count("\n") == 1


def test_looking_at_runs_needs_no_jax():
    modules = ("cli.plot", "cli.compare", "cli.log", "figures.train")
    code = f"import sys, {', '.join(f'ear_jax.{name}' for name in modules)}; print('jax' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
