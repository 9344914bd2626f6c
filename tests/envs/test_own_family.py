"""A user's own family: the document's example as printed, and files and packages that hold families."""

from __future__ import annotations

import dataclasses
import json
import os
import re
from importlib.metadata import EntryPoint
from pathlib import Path

import jax
import jax.numpy as jnp
import pytest

from ear_jax.cli.main import main
from ear_jax.envs import FAMILIES, find_family, make_family
from ear_jax.envs.signature import first_change, signature_of
from ear_jax.errors import UsageError
from ear_jax.runs import loop, records
from ear_jax.runs.loop import train_run
from tests.helpers.runs import tiny_config

DOCUMENT = Path(__file__).parents[2] / "docs" / "your-own-family.md"


@pytest.fixture
def family_file(tmp_path: Path) -> Path:
    """Writes the document's only Python block to a file."""
    blocks = re.findall(r"^```python\n(.*?)^```$", DOCUMENT.read_text(), re.MULTILINE | re.DOTALL)
    assert len(blocks) == 1
    file = tmp_path / "my_family.py"
    file.write_text(blocks[0])
    return file


def test_the_documents_family_is_what_it_says(family_file):
    family = make_family(f"{family_file}:BalanceAt", "native")
    assert (family.name, family.observation_size, family.action_size) == ("balance-at", 4, 1)
    assert family.training_tasks().targets == [-0.6, -0.3, 0.0, 0.3, 0.6]
    assert family.parse_task("at-0.25").params == {"position": 0.25}
    with pytest.raises(UsageError, match="name a position in metres"):
        family.parse_task("left")
    state = jax.jit(family.reset)(jax.random.key(0))
    after = jax.jit(family.step)(state, jnp.array([0.5]))
    position = float(after.pipeline_state.qpos[0])
    assert float(after.reward) == pytest.approx(1 - abs(position + 0.6) - 0.01 * 0.25, abs=1e-6)
    leaning = state.pipeline_state.replace(qpos=jnp.array([0.0, 0.21]))
    assert (bool(family.terminated(leaning)), bool(family.terminated(state.pipeline_state))) == (True, False)


@pytest.mark.parametrize(
    ("part", "old", "new"),
    [
        ("reward", "- 0.01 *", "- 0.02 *"),
        ("outcome", "motion.after.qpos[0]", "motion.before.qpos[0]"),
        ("observe", "physics.qpos, physics.qvel", "physics.qvel, physics.qpos"),
        ("terminated", "> 0.2", "> 0.25"),
        ("initial", "key, 0.05,", "key, 0.04,"),
        ("substeps", "substeps = 2", "substeps = 3"),
        (
            "achieved",
            "    def reward",
            "    def achieved(self, late, whole):\n        return whole['position']\n\n    def reward",
        ),
        (
            "model.opt.gravity",
            "    def reward",
            "    def load(self):\n        model = super().load()\n        model.opt.gravity[2] = -1.62\n"
            "        return model\n\n    def reward",
        ),
        (
            "actuate",
            "    def terminated",
            "    def actuate(self, physics, action):\n        return physics, 2 * action\n\n    def terminated",
        ),
        ("episode_length", "    substeps = 2", "    episode_length = 100\n    substeps = 2"),
    ],
)
def test_a_part_that_computes_something_else_is_named(part, old, new, family_file):
    code, (before, same, now) = family_file.read_text(), (family_file.with_name(f"{name}.py") for name in "abc")
    assert code.count(old) == 1
    before.write_text(code)
    same.write_text(code.replace("outcome", "result").replace("def result", "def outcome") + "# as before\n")
    now.write_text(code.replace(old, new))
    families = [make_family(f"{file}:BalanceAt", "native") for file in (before, same, now)]
    first, again, changed = (signature_of(family, family.training_tasks()) for family in families)
    assert first_change(first, json.loads(json.dumps(again))) is None
    assert first_change(first, changed) == part


def test_a_run_is_not_continued_with_other_code(family_file, run_directory, monkeypatch, capsys):
    tiny = tiny_config(family=f"{family_file}:BalanceAt", tasks=("-0.3", "at-0.3"), epochs=2)
    train_run(tiny, run_directory)
    assert main(["evaluate", str(run_directory), "--family", tiny.family, "--episodes", "1"]) == 0
    assert "warning" not in capsys.readouterr().err
    family_file.write_text(family_file.read_text().replace("- 0.01 *", "- 0.02 *"))
    assert main(["evaluate", str(run_directory), "--family", tiny.family, "--episodes", "1"]) == 0
    said = capsys.readouterr().err
    assert "was trained on other code of its family: reward is not what it was, so its policies may do" in said
    with pytest.raises(UsageError, match="reward is not what it was; use another --out"):
        train_run(dataclasses.replace(tiny, epochs=4), run_directory)


@pytest.mark.slow  # `house/test_extending.py` trains it too
def test_the_documents_family_trains_and_writes_metrics(family_file, run_directory):
    tiny = tiny_config(family=f"{family_file}:BalanceAt", tasks=("-0.3", "at-0.3"), epochs=2)
    train_run(tiny, run_directory)
    rows = records.read_rows(run_directory / "metrics.jsonl")
    assert [(row["epoch"], row["invalid_steps"]) for row in rows] == [(2, 0)]
    assert set(rows[0]["returns"]) == {"at--0.3", "at-0.3"}
    assert all(0 < value < 200 for value in rows[0]["returns"].values())


def test_the_documents_command_is_right(family_file, monkeypatch):
    """The command is followed up to the configuration that reaches the trainer."""
    words = re.search(r"^ear (train \S+:\S+ .*)$", DOCUMENT.read_text(), re.MULTILINE)[1].split()
    asked = []
    monkeypatch.setattr("ear_jax.runs.loop.train_run", lambda config, directory: asked.append(config))
    monkeypatch.chdir(family_file.parent)
    assert main(words) == 0
    assert (asked[0].family, asked[0].preset) == ("my_family.py:BalanceAt", "smoke")
    assert len(loop.training.make_program(asked[0]).tasks) == 5


def test_the_documents_family_can_be_checked_alone(family_file, monkeypatch, capsys):
    words = re.search(r"`ear (families \S+)`", DOCUMENT.read_text())[1].split()
    monkeypatch.chdir(family_file.parent)
    assert main([*words, "--json"]) == 0
    (described,) = json.loads(capsys.readouterr().out)["families"]
    assert described["name"] == "my_family.py:BalanceAt"
    assert described["tasks"] == ["at--0.6", "at--0.3", "at-0", "at-0.3", "at-0.6"]
    assert (described["observation_size"], described["action_size"], described["dt"]) == (4, 1, 0.04)
    assert not Path("runs").exists()


def test_an_installed_package_offers_families_by_entry_point(monkeypatch, capsys):
    point = EntryPoint("bandit", "tests.helpers.probe:Bandit", "ear_jax.families")
    monkeypatch.setattr("ear_jax.names.entry_points", lambda group: [point] * (group == "ear_jax.families"))
    assert make_family("bandit", "native").name == "bandit"
    with pytest.raises(UsageError, match="did you mean 'bandit'"):
        make_family("bandti", "native")
    assert main(["families", "--json"]) == 0
    assert [family["name"] for family in json.loads(capsys.readouterr().out)["families"]] == [*FAMILIES, "bandit"]


def test_a_file_is_run_once_until_it_is_modified(tmp_path, capsys):
    file = tmp_path / "mine.py"
    code = "print('run'); from tests.helpers.probe import Bandit\nclass Mine(Bandit): name = 'mine'"
    for size, text in ((1, code), (2, code + "\n")):
        file.write_text(text)
        os.utime(file, ns=(size, size))
        kinds = [find_family(f"{file}:Mine") for _ in range(3)]
        assert len(set(kinds)) == 1
        assert capsys.readouterr().err == "run\n"


def test_an_installed_package_that_is_broken_is_named(monkeypatch, capsys):
    point = EntryPoint("broken", "nosuchpackage:Mine", "ear_jax.families")
    monkeypatch.setattr("ear_jax.names.entry_points", lambda group: [point])
    assert main(["families"]) == 0
    assert "broken is not available here: family 'broken' cannot be loaded" in capsys.readouterr().out
    assert main(["families", "broken"]) == 2
    line = "ear: family 'broken' cannot be loaded from nosuchpackage:Mine: ModuleNotFoundError: No module named"
    assert capsys.readouterr().err.startswith(line)
    point = EntryPoint("broken", "tests.helpers.probe:SLIDER", "ear_jax.families")
    with pytest.raises(UsageError, match=r"^broken is not a family: it must be a class"):
        find_family("broken")
    assert find_family("ant-dir") is FAMILIES["ant-dir"], "another's fault is not ours"


PARTS = "training_tasks = parse_task = initial = observe = outcome = reward = print"


@pytest.mark.parametrize(
    ("word", "text", "complaint"),
    [
        ("nowhere.py:Mine", None, r"no file nowhere\.py; .* path/to/file\.py:ClassName"),
        ("mine.txt:Mine", "", r"mine\.txt is not a Python file"),
        ("mine.py:Mine", "x = 1", r"unknown family 'Mine' \(there are: none\)"),
        ("mine.py:Mien", "from tests.helpers.probe import Bandit as Mine", r"did you mean 'Mine'"),
        ("mine.py:Mine", "1 / 0", r"mine\.py cannot be run: ZeroDivisionError: division by zero \(mine\.py, line 1"),
        ("mine.py:Mine", "class Mine(:", r"mine\.py cannot be run: SyntaxError"),
        ("mine.py:Mine", "import nosuchpackage", r"cannot be run: ModuleNotFoundError: .*nosuchpackage"),
        ("mine.py:Mine", "import sys; sys.exit(3)", r"mine\.py cannot be run: SystemExit: 3"),
        ("mine.py:Mine", "Mine = 1", r"mine\.py:Mine is not a family: .* derived from ear_jax\.envs\.Family"),
        (
            "mine.py:Mine",
            "class Mine(Family): reward = observe = print",
            r"define initial\(\), outcome\(\), parse_task",
        ),
        ("mine.py:Mine", f"class Mine(Family): {PARTS}", r"mine\.py:Mine does not define name; it must be a non-"),
        ("mine.py:Mine", f"class Mine(Family): name = 'm'; {PARTS}", "does not define substeps; it must be a whole"),
        (
            "mine.py:Mine",
            "class Mine(Bandit): name = ''",
            r"mine\.py:Mine: name must be a non-empty string of .*, but is ''",
        ),
        ("mine.py:Mine", "class Mine(Bandit): substeps = 0.5", r"substeps must be a whole number of .*, but is 0\.5"),
        ("mine.py:Mine", "class Mine(Bandit): mjx_solver = 4", r"mjx_solver must be two whole numbers .*, but is 4"),
        (
            "mine.py:Mine",
            "class Mine(Bandit): presets = ['fast']",
            r"presets must be a dictionary of settings for each",
        ),
        ("mine.py:Mine", "class Mine(Bandit): bodies = 'foot'", r"bodies must be a tuple of names, but is 'foot'"),
        ("mine.py:Mine", "class Mine(Bandit): feet = None", r"feet must be a dictionary of bodies by .*, but is None"),
        ("mine.py:Mine", "class Mine(Bandit): plane = ('x',)", r"plane must be two names of outcomes, or None, but is"),
        (
            "mine.py:Mine",
            "class Mine(Bandit): period = '360'",
            r"period must be a number above 0, or None, but is '360'",
        ),
        ("mine.py:Mine", "class Mine(Bandit): period = 0", r"period must be a number above 0, or None, but is 0"),
        ("mine.py:Mine", "class Mine(Bandit): load = Family.load", "does not define model_file; it must be one of Gym"),
        (
            "mine.py:Mine",
            "class Mine(Bandit):\n  def load(self):\n    return open('robot.xml')",
            r"^mine\.py:Mine: its constructor fails: FileNotFoundError: .*robot\.xml' \(mine\.py, line 4, in load\)$",
        ),
    ],
)
def test_a_file_that_holds_no_family(word, text, complaint, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    if text is not None:
        imports = "from ear_jax.envs import Family; from tests.helpers.probe import Bandit\n"
        Path(word.partition(":")[0]).write_text(imports * text.startswith("class Mine(") + text)
    with pytest.raises(UsageError, match=complaint):
        make_family(word, "native")
    assert main(["train", word]) == 2
    streams = capsys.readouterr()
    assert (streams.out, streams.err.count("\n")) == ("", 1)
    assert not Path("runs").exists()
