"""A family of a user's own: the document's example exactly as printed, and the faults that are refused in one line."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import jax
import jax.numpy as jnp
import pytest
from conftest import tiny_config
from probe import Bandit

from ear_jax import records, run
from ear_jax.cli.main import main
from ear_jax.envs import FAMILIES, make_family
from ear_jax.errors import UsageError
from ear_jax.physics import Physics
from ear_jax.run import train_run
from ear_jax.tasks import Task, task_set

DOCUMENT = Path(__file__).parents[1] / "docs" / "your-own-family.md"


@pytest.fixture
def family_file(tmp_path: Path) -> Path:
    """The document's only Python block."""
    blocks = re.findall(r"^```python\n(.*?)^```$", DOCUMENT.read_text(), re.MULTILINE | re.DOTALL)
    assert len(blocks) == 1
    file = tmp_path / "my_family.py"
    file.write_text(blocks[0])
    return file


def test_the_documents_family_is_what_it_says(family_file):
    family = make_family(f"{family_file}:BalanceAt", "native")
    assert (family.name, family.observation_size, family.action_size) == ("balance-at", 4, 1)
    assert family.training_tasks().targets == [-0.6, -0.3, 0.0, 0.3, 0.6]
    assert family.interpolation_tasks().targets == [-0.45, -0.15, 0.15, 0.45]
    assert family.parse_task("at-0.25").params == {"position": 0.25}
    with pytest.raises(UsageError, match="name a place in metres"):
        family.parse_task("left")
    state = jax.jit(family.reset)(jax.random.key(0))
    after = jax.jit(family.step)(state, jnp.array([0.5]))
    position = float(after.pipeline_state.qpos[0])
    assert float(after.reward) == pytest.approx(1 - abs(position + 0.6) - 0.01 * 0.25, abs=1e-6)
    leaning = state.pipeline_state.replace(qpos=jnp.array([0.0, 0.21]))
    assert (bool(family.terminated(leaning)), bool(family.terminated(state.pipeline_state))) == (True, False)


def test_the_documents_family_trains_and_writes_metrics(family_file, run_directory):
    tiny = tiny_config(family=f"{family_file}:BalanceAt", tasks=("-0.3", "at-0.3"), epochs=2)
    train_run(tiny, run_directory)
    rows = records.read_rows(run_directory / "metrics.jsonl")
    assert [(row["epoch"], row["invalid_steps"]) for row in rows] == [(2, 0)]
    assert set(rows[0]["returns"]) == {"at--0.3", "at-0.3"}
    assert all(0 < value < 200 for value in rows[0]["returns"].values())


def test_the_documents_command_is_right(family_file, monkeypatch):
    """As a shell would run it, up to the configuration that reaches the trainer."""
    words = re.search(r"^ear (train \S+:\S+ .*)$", DOCUMENT.read_text(), re.MULTILINE)[1].split()
    asked = []
    monkeypatch.setattr("ear_jax.cli.train.train_run", lambda config, directory: asked.append(config))
    monkeypatch.chdir(family_file.parent)
    assert main(words) == 0
    assert (asked[0].family, asked[0].preset) == ("my_family.py:BalanceAt", "smoke")
    assert len(run.train.make_program(asked[0]).tasks) == 5


def test_an_installed_package_offers_families_by_entry_point(monkeypatch):
    offered = type("Point", (), {"name": "bandit", "load": staticmethod(lambda: Bandit)})
    monkeypatch.setattr("ear_jax.envs.registry.entry_points", lambda group: [offered] * (group == "ear_jax.families"))
    assert make_family("bandit", "native").name == "bandit"
    with pytest.raises(UsageError, match="did you mean 'bandit'"):
        make_family("bandti", "native")


@pytest.mark.parametrize(
    ("word", "text", "complaint"),
    [
        ("nowhere.py:Mine", None, r"no file nowhere\.py; .* path/to/file\.py:ClassName"),
        ("mine.py:Mine", "x = 1", r"unknown family 'Mine'"),
        ("mine.py:Mien", "from probe import Bandit as Mine", r"did you mean 'Mine'"),
        ("mine.py:Mine", "1 / 0", r"mine\.py cannot be run: ZeroDivisionError: division by zero"),
        ("mine.py:Mine", "class Mine(:", r"mine\.py cannot be run: SyntaxError"),
        ("mine.py:Mine", "import nosuchpackage", r"cannot be run: ModuleNotFoundError: .*nosuchpackage"),
        ("mine.txt:Mine", "", r"mine\.txt is no Python file"),
    ],
)
def test_a_file_that_holds_no_family(word, text, complaint, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    if text is not None:
        Path(word.partition(":")[0]).write_text(text)
    with pytest.raises(UsageError, match=complaint):
        make_family(word, "native")
    assert main(["train", word]) == 2
    streams = capsys.readouterr()
    assert (streams.out, streams.err.count("\n")) == ("", 1)
    assert not Path("runs").exists()


class NoScalarReward(Bandit):
    def reward(self, outcome, task):
        return jnp.ones(2) * task["action"]


class NotFiniteOutcome(Bandit):
    def outcome(self, motion):
        return {"action": motion.action[0] / jnp.sum(jnp.abs(motion.after.qpos - motion.before.qpos))}


class NoScalarOutcome(Bandit):
    def outcome(self, motion):
        return {"action": motion.action}


class NoOutcome(Bandit):
    def outcome(self, motion):
        return motion.action[0]


class MatrixObservation(Bandit):
    def observe(self, physics):
        return jnp.ones((1, 1))


class UnlikeTasks(Bandit):
    def training_tasks(self):
        return task_set([Task("one", 1.0, {"action": 1.0}), Task("two", 2.0, {"velocity": 2.0})])


class NotFiniteTask(Bandit):
    def training_tasks(self):
        return task_set([Task("one", 1.0, {"action": float("inf")})])


class ShortStart(Bandit):
    def initial(self, key):
        return Physics(jnp.zeros(1), jnp.zeros(2), jnp.zeros(1))


class VectorTermination(Bandit):
    def terminated(self, physics):
        return physics.qpos > 0


class FailingReward(Bandit):
    def reward(self, outcome, task):
        return outcome["speed"]


@pytest.mark.parametrize(
    ("kind", "complaint"),
    [
        (NoScalarReward, r"reward\(\) must be a scalar, and has shape \(2,\)"),
        (NotFiniteOutcome, r"outcome\(\)\['action'\] is nan at a fresh start; it must be finite"),
        (NoScalarOutcome, r"outcome\(\)\['action'\] must be a scalar, and has shape \(1,\)"),
        (NoOutcome, r"outcome\(\) must be a dictionary of named scalars"),
        (MatrixObservation, r"observe\(\) must be a vector, and has shape \(1, 1\)"),
        (UnlikeTasks, r"tasks 'one' and 'two' have different numbers in their params"),
        (NotFiniteTask, r"the params of task 'one' must be finite numbers"),
        (ShortStart, r"initial\(\)\.qvel must be of shape \(1,\), and has shape \(2,\)"),
        (VectorTermination, r"terminated\(\) must be a scalar, and has shape \(1,\)"),
        (FailingReward, r"reward\(\) fails: KeyError: 'speed'"),
    ],
    ids=lambda value: getattr(value, "__name__", ""),
)
def test_a_bad_family_is_refused_before_anything_is_compiled(kind, complaint, monkeypatch, run_directory):
    monkeypatch.setitem(FAMILIES, "bandit", kind)
    monkeypatch.setattr(run, "compile_program", lambda *_: pytest.fail("it came to compiling"))
    config = dataclasses.replace(tiny_config(), family="bandit", tasks=())
    with pytest.raises(UsageError, match="^bandit: " + complaint) as raised:
        train_run(config, run_directory)
    assert "\n" not in str(raised.value)
    assert not run_directory.exists()
