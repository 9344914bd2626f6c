"""A workplace in which runs cost nothing."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from ear_jax.cli import train
from ear_jax.config import run_name
from experiments import inventory, reproduce
from tests.helpers.fake_records import write_run


@pytest.fixture
def workplace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Replaces `ear` by one that trains at once and starts without records; returns the command lines it gets."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(inventory, "RECORDS", tmp_path / "records")
    asked: list[str] = []

    def run_ear(words: list[str]) -> str:
        asked.append(" ".join(words))
        if words[0] == "export":
            return str(Path(words[2]).write_bytes(b"policy"))
        if words[0] != "train":
            return json.dumps({"answer": len(asked)})
        config = train.read(words[1:]).config
        write_run(tmp_path / "runs" / run_name(config), config)
        return ""

    monkeypatch.setattr(reproduce, "run_ear", run_ear)
    return asked
