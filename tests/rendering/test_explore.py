"""The page that replays roll-outs of the sphere of LTEs: the piece of a roll-out that repeats, and the page's data."""

from __future__ import annotations

import base64
import json
import re
import shutil
import webbrowser
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ear_jax.cli.main import main
from ear_jax.figures.explore import Loop, write_page
from ear_jax.rendering.explore import loop
from ear_jax.rendering.scene import limbs
from tests.helpers.cheetah import running

SECONDS = 0.05
SPEED = 2.0


@pytest.fixture
def gait(cheetah):
    """Returns 5 s at 2 m/s with a leg that swings every 12 steps, a little less each time."""
    trajectory = running(cheetah, SPEED)
    step = np.arange(len(trajectory.qpos))
    trajectory.qpos[:, 3] = 0.5 * np.sin(2 * np.pi * step / 12) * (1 - step / 1000)
    return trajectory


@pytest.fixture(scope="module")
def run(finished_once: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return Path(shutil.copytree(finished_once, tmp_path_factory.mktemp("explore") / "run"))


def test_what_repeats_is_whole_strides(cheetah, gait):
    piece = loop(cheetah, gait, 1, SECONDS)
    assert len(piece.limbs) == 24, "the strides of 12 pictures that fit between 1.0 and 1.6 s"
    assert not piece.fell
    np.testing.assert_allclose(piece.path[-1] - piece.path[0], [24 * SPEED * SECONDS, 0], atol=1e-2)
    seen = limbs(cheetah, gait.qpos[50:])
    first = int(np.argmin(np.abs(seen.centres[:, 0] - piece.path[0, 0])))
    np.testing.assert_allclose(piece.path[:, 0], seen.centres[first : first + 25, 0])
    across = seen.ends[first, ..., 0] - seen.centres[first, 0]
    np.testing.assert_allclose(piece.limbs[0, ..., 0], across, err_msg="limbs stand about the robot's own place")


def test_pictures_are_left_out_where_steps_are_short(cheetah, gait):
    piece = loop(cheetah, gait, 3, 3 * SECONDS)
    assert len(piece.limbs) == 8, "of the same 24 steps a third"


def test_who_fell_is_shown_to_the_end(cheetah, gait):
    piece = loop(cheetah, replace(gait, qpos=gait.qpos[:31], fell=True), 1, SECONDS)
    assert piece.fell
    assert (len(piece.limbs), len(piece.path)) == (16, 17)
    assert len(loop(cheetah, replace(gait, qpos=gait.qpos[:2], fell=True), 1, SECONDS).limbs) == 1, "in its first step"


def numbers(text: str) -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), "<i2") / 1000


def held(page: Path) -> dict:
    return json.loads(re.findall(r'<script id="data" type="application/json">(.*?)</script>', page.read_text())[0])


def test_a_page_holds_all_to_the_millimetre(tmp_path):
    draw = np.random.default_rng(0).normal
    pieces = [Loop(draw(size=(n, 3, 2, 2)), 4 + draw(size=(n + 1, 2)), fell) for n, fell in ((5, False), (2, True))]
    document = {
        "title": "</script><b>of a user's family",
        "commanded": {"outcome": "velocity", "unit": "m/s", "period": None},
        "achieved": [1.0, 3.0],
        "trained": [],
    }
    data = held(write_page(tmp_path / "page.html", document, pieces))
    assert data["title"] == document["title"]
    assert (data["pictures"], data["fell"], data["scale"]) == ([5, 2], [False, True], [1, 3])
    assert (data["shades"][0], data["shades"][-1]) == ("#440154", "#fde725"), "viridis"
    shown = np.concatenate([piece.limbs.ravel() for piece in pieces])
    np.testing.assert_allclose(numbers(data["limbs"]), shown, atol=0.00051)
    path = np.concatenate([(piece.path - piece.path[0]).ravel() for piece in pieces])
    np.testing.assert_allclose(numbers(data["path"]), path, atol=0.00051)
    assert "{{" not in (tmp_path / "page.html").read_text()


def test_the_command_makes_a_page_of_a_run_and_opens_it(run, monkeypatch, capsys):
    opened: list[str] = []
    monkeypatch.setattr(webbrowser, "open", opened.append)
    assert main(["explore", str(run), "--replay", "--places", "12", "--steps", "40", "--json", "--open"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert opened == [Path(document["page"]).resolve().as_uri()]
    data = held(Path(document["page"]))
    assert Path(document["page"]) == run / "explore_seed0_replay_places-12_steps-40.html"
    assert document["live"] is False
    assert len(document["achieved"]) == len(data["pictures"]) == 12
    assert [task["name"] for task in data["trained"]] == ["vel-1", "vel-3"]
    limbs_of_a_cheetah = len(data["radii"])
    assert len(numbers(data["limbs"])) == 4 * limbs_of_a_cheetah * sum(data["pictures"])
    assert len(numbers(data["path"])) == 2 * (sum(data["pictures"]) + 12)


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        ("--places 3", "--places 3 is too small; it must be at least 10"),
        ("--steps 1", "--steps 1 is too small; it must be at least 8"),
        ("--policy 2", "--policy 2 is out of range: this run has 2 policies, numbered from 0"),
    ],
)
def test_a_mistake_gets_one_clear_line_and_leaves_nothing(run, words, complaint, capsys):
    before = sorted(run.rglob("*"))
    assert main(["explore", str(run), *words.split()]) == 2
    assert capsys.readouterr().err == f"ear: {complaint}\n"
    assert sorted(run.rglob("*")) == before
