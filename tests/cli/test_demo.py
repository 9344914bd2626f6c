"""`ear demo` ends with the robot seen, and with commands that work on its run."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import pytest
from PIL import Image

from ear_jax.cli.main import main
from tests.helpers.runs import tiny_config


@pytest.mark.slow
def test_the_demo_shows_the_robot_and_proposes_commands(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    small = tiny_config(tasks=("1", "2", "3"), sac=dataclasses.replace(tiny_config().sac, batch_size=33))
    monkeypatch.setattr("ear_jax.presets.preset_config", lambda *_: small)
    assert main(["demo"]) == 0
    streams = capsys.readouterr()
    picture = Path("runs/demo/figures/demo.png")
    assert f"{picture} shows the robot at each speed" in streams.out
    assert min(Image.open(picture).size) > 200
    proposed = [line.split()[1:3] for line in streams.err.splitlines() if line.startswith("  ear ")]
    assert proposed == [[name, "runs/demo"] for name in ("interpolate", "render", "adapt")] + [
        ["train", "halfcheetah-vel"]
    ]
    assert main(["demo", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["mean_absolute_error"] > 0
