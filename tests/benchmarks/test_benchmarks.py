"""Conclusions of benchmarks from rows with known answers, and a small run of each. Their timings are not tested."""

from __future__ import annotations

import argparse
import dataclasses
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks import adaptation, common, gpu, recipe, scale
from benchmarks.gpu_page import draw_page
from benchmarks.time_to_return import passed
from ear_jax.embeddings.interpolate import FRESH
from ear_jax.runs import records
from tests.helpers.overlap import overlaps
from tests.helpers.runs import tiny_config

ROOT = Path(__file__).parents[2]


def test_a_mark_is_passed_by_three_evaluations_in_a_row():
    rows = [{"mean_return": value, "updates": index} for index, value in enumerate((0, 9, 0, 4, 6, 5, 1))]
    assert passed(rows, 5)["updates"] == 5, "of 4, 6 and 5 the mean is 5; the lucky 9 counts for nothing alone"
    assert passed(rows, 3)["updates"] == 2, "0, 9 and 0"
    assert passed(rows, 5.1) is None
    assert passed(rows[:2], 0) is None


def test_seconds_to_a_mark_are_the_median_over_seeds():
    passed = {-350: (3.0, 1.0, 2.0), -300: (9.0, None, 8.0), -250: (None, 20.0, None), -200: (None, None, None)}
    rows = [
        {"seed": seed, "return": mark, **({"seconds": seconds} if seconds else {"passed": False})}
        for mark, of_seeds in passed.items()
        for seed, seconds in enumerate(of_seeds)
    ]
    assert gpu.to_marks(rows) == {
        "to_-350_passed": 3,
        "to_-350_s": 2.0,
        "to_-300_passed": 2,
        "to_-300_s": 9.0,
        "to_-250_passed": 1,
        "to_-200_passed": 0,
    }


def test_a_page_without_panels_is_not_drawn(tmp_path):
    assert draw_page(tmp_path) is None
    records.append_rows(tmp_path / "gpu.jsonl", [{"what": "run", "quick": False, "run_s": 1.0}])
    assert draw_page(tmp_path) is None


def test_every_measurement_of_a_run_trains_a_new_one(monkeypatch):
    config, trained = tiny_config(), []

    def train(config, directory):
        assert not directory.exists()
        directory.mkdir()
        records.write_json(directory / "config.json", {"config": dataclasses.asdict(config)})
        records.append_rows(directory / "metrics.jsonl", [])
        trained.append(directory)

    monkeypatch.setattr(gpu, "train_run", train)
    rows = [gpu.measure_run(argparse.Namespace(), config) for _ in range(2)]
    assert len(trained) == len(rows) == 2
    assert not any(directory.exists() for directory in trained)


@pytest.mark.parametrize(
    ("command", "document", "steps"),
    [
        ("map", {"seeds": [{"ltes": [[0, 0, 1]] * 7}] * 2}, 2 * 7 * 3 * 200),
        ("interpolate", {"pairs": [{}, {}], "betas": [0.1, 0.2, 0.3, 0.4]}, 2 * (4 * 3 + FRESH) * 200),
        (
            "adapt",
            {
                "tasks": [{"epochs": [{}, {}], "target": 3.6}, {"epochs": [{}, {}], "target": None}],
                "env_steps": 10_000,
                "map_env_steps": 2000,
            },
            10_000 + 2000 + (2 + 2 + 1) * 3 * 200,
        ),
    ],
)
def test_the_env_steps_of_a_command_include_its_evaluations(command, document, steps):
    assert adaptation.env_steps(command, document, episodes=3, steps=200) == steps


@pytest.mark.parametrize(
    ("words", "code", "error"),
    [
        ("time_to_return nowhere", 2, "nowhere is not a run directory"),
        ("equal_bits nothing", 2, "unknown preset 'nothing'"),
        ("figures --results nowhere", 1, "no results in nowhere"),
    ],
)
def test_a_mistake_ends_in_one_line(words, code, error, tmp_path):
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    name, *rest = words.split()
    command = [sys.executable, "-m", f"benchmarks.{name}", *rest]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=120)
    (line,) = done.stderr.splitlines()
    assert line.startswith(f"{name}: {error}")
    assert done.returncode == code


def test_every_benchmark_with_arguments_ends_so():
    for path in (ROOT / "benchmarks").glob("[!_]*.py"):
        text = path.read_text()
        if "common.arguments(__doc__)" in text or ("ArgumentParser(" in text and path.name != "common.py"):
            assert f'sys.exit(exit_code("{path.stem}", main))' in text, path.name


def test_scale_rewrites_its_document_from_the_committed_rows_alone(tmp_path, monkeypatch):
    written = []
    monkeypatch.setattr(scale, "against", lambda *_: None)
    monkeypatch.setattr(scale.documents, "put", lambda *words: written.append(words))
    for words in (["--results", str(tmp_path)], ["--quick"], []):
        monkeypatch.setattr(sys, "argv", ["scale", *words])
        scale.main()
    assert written == [(scale.DOCUMENT, scale.PLACE, scale.costs())]


def test_scale_reads_rows_in_any_order(tmp_path):
    for name in ("scale", "saving", "cluster"):
        shutil.copy(common.RESULTS / f"{name}.jsonl", tmp_path)
    rows = scale.measured("scale", tmp_path)
    (old,) = [row for row in rows if scale.ONE_HOT.items() <= row.items()]
    path = tmp_path / "scale.jsonl"

    def costs_of(rows):
        path.unlink()
        records.append_rows(path, rows)
        return scale.costs(tmp_path)

    before = {**old, "commit": "before", "update_seconds": 99.0}
    assert costs_of([before, *rows]) == scale.costs(), "an earlier row of that size changes nothing"
    assert "one-hot" not in costs_of([row for row in rows if row is not old])


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["physics", "update", "matmul", "chunk", "startup", "adaptation", "saving", "sweep", "scale"]
)
def test_a_benchmark_runs_in_small(name, tmp_path):
    words = [sys.executable, "-m", f"benchmarks.{name}", "--quick", "--results", str(tmp_path)]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, timeout=900)
    assert done.returncode == 0, done.stderr
    rows = records.read_rows(tmp_path / f"{name}.jsonl")
    assert rows
    assert all(row["quick"] and "unavailable" not in row for row in rows)


@pytest.mark.slow
def test_the_script_for_a_gpu_runs_to_its_end_in_small(tmp_path):
    """Only PyTorch may be missing. On the CPU fresh processes have equal bits, with one cache and with two."""
    words = [sys.executable, "-m", "benchmarks.gpu", "--quick", "--minutes", "20", "--results", str(tmp_path)]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, timeout=1500)
    assert done.returncode == 0, done.stderr
    rows = records.read_rows(tmp_path / "gpu.jsonl")
    assert not [row for row in rows if "failed" in row and "no PyTorch" not in row["failed"]]
    assert {row["what"] for row in rows} >= {"update", "epoch", "collect", "bits", "run"}
    (bits,) = [row for row in rows if row["what"] == "bits"]
    assert bits["equal_with_fresh_caches"]
    assert bits["equal_with_one_cache"]
    assert (tmp_path / "gpu.png").exists()


@pytest.mark.parametrize("family", ["", "hopper-vel"], ids=["all families", "one family"])
def test_no_part_of_the_picture_of_trials_lies_over_another(family, tmp_path, monkeypatch):
    found = []
    rows = [row for row in records.read_rows(common.RESULTS / "recipe.jsonl") if row["family"].startswith(family)]
    monkeypatch.setattr(recipe.records, "read_rows", lambda _: rows)
    monkeypatch.setattr(recipe, "save_figure", lambda figure, path: found.extend(overlaps(figure)))
    monkeypatch.setattr(recipe.documents, "put", lambda *_: None)
    recipe.main(tmp_path / "recipe.png")
    assert found == []
