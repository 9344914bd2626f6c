"""Bits that flip in the files of a run: each is found, or has changed no number."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ear_jax import pretrained
from ear_jax.embeddings import ltes
from ear_jax.errors import RunError, UsageError
from ear_jax.runs import checkpoint, records
from ear_jax.runs.export import read_about, read_policy
from ear_jax.runs.trained import load, save
from tests.helpers.faults import flips

COUNTS = [40, pytest.param(400, marks=pytest.mark.slow)]


def assert_found(path: Path, read: Callable[[], Any], count: int) -> None:
    """Asserts that a file with a flipped bit is refused, or read as it was."""
    good, content = read(), path.read_bytes()
    for flipped in flips(content, count):
        path.write_bytes(flipped)
        with contextlib.suppress(RunError, UsageError):
            assert same(read(), good), f"a flip in {path.name}"
    path.write_bytes(content)
    assert same(read(), good)


def same(read: Any, good: Any) -> bool:
    """Returns whether what was read says the same; the name of a checksum that was lost may be one key more."""
    if isinstance(good, dict):
        return (
            good.keys() <= read.keys()
            and len(read) <= len(good) + 1
            and all(same(read[key], good[key]) for key in good)
        )
    if isinstance(good, list):
        return len(read) == len(good) and all(map(same, read, good))
    return bool(np.array_equal(read, good))


@pytest.mark.parametrize("count", COUNTS)
def test_config_json_and_metrics(count, finished):
    assert_found(finished / "config.json", lambda: records.read_run(finished), count)
    log = finished / "metrics.jsonl"
    assert_found(log, lambda: records.read_rows(log, required=records.METRICS), count)


@pytest.mark.parametrize("count", COUNTS)
def test_kept_ltes(count, tmp_path):
    for name, code in (("trot", [0.6, 0.8, 0.0]), ("walk", [-0.1234567, 0.5, 0.25])):
        ltes.save(tmp_path, name, "vel-1.5", [code], "1f" * 8)
    assert_found(tmp_path / ltes.FILE, lambda: ltes.saved(tmp_path), count)


@pytest.mark.parametrize("count", COUNTS)
def test_cards(count, tmp_path, monkeypatch):
    monkeypatch.setattr(pretrained, "FOLDER", Path(shutil.copytree(pretrained.FOLDER, tmp_path / "agents")))
    for name in ("hopper-vel", "ant-dir"):
        assert_found(pretrained.FOLDER / f"{name}.json", lambda: pretrained.card(name), count)  # noqa: B023


@pytest.mark.parametrize("count", COUNTS)
def test_exported_files(count, finished, tmp_path):
    file = tmp_path / "policy.safetensors"
    save(file, load(finished), [])

    def read() -> Any:
        about, header = read_about(file)
        return [about, read_policy(file, header)]

    assert_found(file, read, count)


@pytest.mark.parametrize("count", COUNTS)
def test_steps(count, finished):
    """One flip in each of many files: the step is passed over for the one before."""
    step = finished / "checkpoints" / "24"
    files = sorted(path for path in step.rglob("*") if path.is_file())
    for path in files:
        content = path.read_bytes()
        for flipped in flips(content, -(-count // len(files))):
            path.write_bytes(flipped)
            warnings: list[str] = []
            assert checkpoint.newest(finished / "checkpoints", warnings.append).epoch == 18
            assert "24 is damaged" in warnings[0]
        path.write_bytes(content)
    assert checkpoint.newest(finished / "checkpoints", pytest.fail).epoch == 24
