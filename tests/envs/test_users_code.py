"""A user's file of a family: what it prints, the files beside it, and anything that it may raise at any time."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from ear_jax.cli.main import main
from ear_jax.envs import find_family
from ear_jax.errors import UsageError

IMPORTS = "import traceback; from tests.helpers.probe import Bandit\n"
LATER = """  def training_tasks(self):
    if "check_family" in [frame.name for frame in traceback.extract_stack()]: return super().training_tasks()
    raise"""


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_what_users_code_prints_goes_to_stderr(here, capsys):
    text = """
print("at import")
class Mine(Bandit):
    def training_tasks(self):
        print("in training_tasks")
        return super().training_tasks()
    def reward(self, outcome, task):
        print("in reward", flush=True)
        return super().reward(outcome, task)
"""
    (here / "mine.py").write_text(IMPORTS + text)
    assert main(["families", "mine.py:Mine", "--json"]) == 0
    streams = capsys.readouterr()
    assert json.loads(streams.out)["families"][0]["tasks"] == ["-0.5", "0.5"]
    assert {"at import", "in training_tasks", "in reward"} <= set(streams.err.splitlines())


def test_a_file_imports_its_neighbours_and_not_those_of_another(here, monkeypatch):
    monkeypatch.setattr(sys, "path", [*sys.path])
    for name in ("one", "two"):
        folder = here / name
        folder.mkdir()
        (folder / "base.py").write_text(f"{IMPORTS}class Cart(Bandit): name = '{name}'\n")
        lazily = "    @classmethod\n    def late(cls):\n        import lately\n        return lately.NAME\n"
        (folder / "fam.py").write_text(f"from base import Cart\nclass Mine(Cart):\n{lazily}")
        (folder / "lately.py").write_text(f"NAME = '{name}'")
    families = [find_family(f"{name}/fam.py:Mine") for name in ("one", "two")]
    assert [family.name for family in families] == ["one", "two"]
    assert families[1].late() == "two"
    assert sys.path[0] != str(here / "two"), "what others import is not hidden"
    (here / "one" / "base.py").write_text(f"{IMPORTS}class Cart(Bandit): name = 'changed'\n")
    (here / "one" / "fam.py").write_text("from base import Cart as Mine\n")
    assert find_family("one/fam.py:Mine").name == "changed"


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (
            "class Odd(BaseException): pass\nraise Odd('at import')",
            "fam.py cannot be run: Odd: at import (fam.py, line 3",
        ),
        ("raise GeneratorExit", "fam.py cannot be run: GeneratorExit (fam.py, line 2"),
        ("import helper", "fam.py cannot be run: ZeroDivisionError: division by zero (helper.py, line 1"),
        (
            "class Mine(Bandit):\n  def observe(self, physics):\n    raise SystemExit(3)",
            "observe() fails: SystemExit: 3 (fam.py, line 4, in observe)",
        ),
        (
            f"class Mine(Bandit):\n{LATER} ValueError('only\\nlater')",
            "ear: ValueError: only (fam.py, line 5, in training_t",
        ),
        (
            f"class Late(BaseException): pass\nclass Mine(Bandit):\n{LATER} Late",
            "ear: Late (fam.py, line 6, in training_tasks)",
        ),
    ],
)
def test_whatever_it_raises_is_one_line(text, complaint, here, capsys):
    (here / "fam.py").write_text(IMPORTS + text)
    (here / "helper.py").write_text("1 / 0")
    assert main(["train", "fam.py:Mine", "--engine", "native", "--dry-run"]) == 2
    streams = capsys.readouterr()
    assert streams.out == ""
    (line,) = streams.err.splitlines()
    assert complaint in line


def test_ctrl_c_in_users_code_still_stops(here):
    (here / "fam.py").write_text("raise KeyboardInterrupt")
    with pytest.raises(KeyboardInterrupt):
        find_family("fam.py:Mine")


@pytest.mark.parametrize("name", ["\x1b[31m", "a\nb", "\udcff"])
def test_a_name_that_no_terminal_shows_is_refused(name, here):
    (here / "fam.py").write_text(f"{IMPORTS}class Mine(Bandit): name = {name!r}\n")
    with pytest.raises(UsageError, match="name must be a non-empty string of printable characters"):
        find_family("fam.py:Mine")


def test_a_file_without_a_class_suggests_its_class(here, capsys):
    (here / "fam.py").write_text(f"{IMPORTS}X = 1\nclass Plain: pass\nclass Cart(Bandit): name = 'cart'\n")
    for word in ("fam.py", "./fam.py"):
        assert main(["train", word]) == 2
        assert f"{word} names no class; name your own family as {word}:Cart" in capsys.readouterr().err
    assert main(["families", "lost.py"]) == 2
    assert "name your own family as lost.py:ClassName" in capsys.readouterr().err


def test_a_model_of_ones_own_is_told_of_load(here, capsys):
    text = "from ear_jax.envs import Family\nclass Mine(Bandit):\n  load = Family.load\n  model_file = 'my_robot.xml'\n"
    (here / "fam.py").write_text(IMPORTS + text)
    assert main(["families", "fam.py:Mine"]) == 2
    complaint = capsys.readouterr().err
    assert "unknown model 'my_robot.xml' (there are: " in complaint
    assert complaint.endswith("for a model of your own, define load() to return its mujoco.MjModel\n")
