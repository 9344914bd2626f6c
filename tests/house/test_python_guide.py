"""The document on use from Python: its blocks run as one program, exactly as printed."""

from __future__ import annotations

import importlib
import inspect
import re
from pathlib import Path

import numpy as np

from ear_jax.runs import loop, training

DOCUMENT = Path(__file__).parents[2] / "docs" / "python.md"


def test_the_documents_program_runs(tmp_path, monkeypatch):
    """Training, which would take an hour, is left out; its settings are checked instead."""
    monkeypatch.chdir(tmp_path)
    trained = []
    monkeypatch.setattr(loop, "train_run", lambda config, directory: trained.append((config, directory)))
    blocks = re.findall(r"^```python\n(.*?)^```$", DOCUMENT.read_text(), re.MULTILINE | re.DOTALL)
    names: dict = {}
    exec(compile("\n".join(blocks), str(DOCUMENT), "exec"), names)
    assert names["action"].shape == (6,)
    assert np.all(np.abs(names["action"]) <= 1)
    assert 2.2 < names["velocity"] < 2.8
    assert np.isfinite(names["reward"])
    assert names["over"] == 0
    ((config, directory),) = trained
    training.make_program(config)  # which checks the settings
    assert (config.seed, config.sac.lte_noise, directory) == (1, 0.0, Path("runs/mine"))


def test_the_calls_in_its_table_can_be_made():
    rows = re.findall(r"^\| `ear [^|]*\| `(\w+)` \| `(\w+)\((.*?)\)` \|", DOCUMENT.read_text(), re.MULTILINE)
    assert len(rows) == 11
    for module, function, arguments in rows:
        called = inspect.signature(getattr(importlib.import_module(f"ear_jax.embeddings.{module}"), function))
        assert [*called.bind(*arguments.split(", ")).arguments] == arguments.split(", ")
