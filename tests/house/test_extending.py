"""The documents' method and family join a copy of the package by one file and one line in a registry each."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.helpers.quick import shared_cache

ROOT = Path(__file__).parents[2]
SMALL = (
    "--preset smoke --engine native --epochs 2 --network.width 16 --sac.batch-size 32 --sac.updates 4 --collect.envs 2 "
    "--collect.steps 5 --collect.pretrain-epochs 2 --replay.capacity 400 --log.epochs 2 --log.episodes 1"
)


def block(document: str) -> str:
    """Returns the only Python block of a document."""
    text = (ROOT / "docs" / document).read_text()
    (found,) = re.findall(r"^```python\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    return found


def add(package: Path, room: str, registry: str, name: str, content: str) -> None:
    """Adds one file to a room and one line to its list in `names.py`."""
    (package / room / f"{name}.py").write_text(content)
    names = package / "names.py"
    text, count = re.subn(rf"^({registry} = \(.*)\n", rf'\1\n    "{name}",\n', names.read_text(), flags=re.MULTILINE)
    assert count == 1
    names.write_text(text)


@pytest.fixture
def extended(tmp_path: Path) -> Path:
    """Makes a copy of the package with one more method and one more family, and without the agents that ship."""
    package = Path(
        shutil.copytree(
            ROOT / "ear_jax",
            tmp_path / "ear_jax",
            ignore=shutil.ignore_patterns("__pycache__", "*.safetensors", "*.json"),
        )
    )
    add(package, "methods", "METHOD_FILES", "ear_c51", block("extending.md"))
    add(package, "envs", "FAMILY_FILES", "balance_at", block("your-own-family.md") + "\n\nFAMILY = BalanceAt\n")
    return tmp_path


def python(directory: Path, *words: str, timeout: float = 900) -> subprocess.CompletedProcess[str]:
    """Runs a module with the directory's package in place of the installed one."""
    path = os.pathsep.join(map(str, (directory, ROOT)))
    environment = {**os.environ, **shared_cache(), "PYTHONPATH": path}
    command = [sys.executable, "-m", *words]
    return subprocess.run(command, cwd=directory, env=environment, capture_output=True, text=True, timeout=timeout)


def test_a_new_method_trains_a_new_family(extended):
    words = ["train", "balance-at", "--tasks", "-0.3", "0.3", "--agent", "ear-c51", *SMALL.split(), "--out", "run"]
    done = python(extended, "tests.helpers.quick", *words)
    assert done.returncode == 0, done.stderr
    about = json.loads((extended / "run" / "config.json").read_text())
    assert (about["config"]["family"], about["config"]["agent"]) == ("balance-at", "ear-c51")
    assert [task["name"] for task in about["tasks"]] == ["at--0.3", "at-0.3"]
    (row,) = map(json.loads, (extended / "run" / "metrics.jsonl").read_text().splitlines())
    assert (row["epoch"], row["updates"], set(row["returns"])) == (2, 8, {"at--0.3", "at-0.3"})
    assert (extended / "run" / "checkpoints" / "2").is_dir()


@pytest.mark.slow
def test_tests_of_all_methods_and_families_hold_for_new_ones_unchanged(extended):
    """The tests that go over all methods and families run on the copy as they are, without knowing the new names."""
    for name in ("tests", "benchmarks", "experiments"):
        ignored = shutil.ignore_patterns("__pycache__", "records", "results")
        shutil.copytree(ROOT / name, extended / name, ignore=ignored)
    shutil.copy(ROOT / "pyproject.toml", extended)
    (extended / "experiments" / "records").mkdir()
    chosen = ("c51", "balance", "every_agent", "refused", "real", "order")
    places = [f"tests/{place}" for place in ("methods", "envs/test_tasks.py", "cli/test_cli.py", "physics", "agents")]
    words = ["pytest", "-m", "slow or not slow", "-k", " or ".join(chosen), *places]
    done = python(extended, *words, timeout=3000)
    assert done.returncode == 0, done.stdout[-3000:]
    passed = re.search(r"(\d+) passed", done.stdout)
    assert passed
    assert int(passed[1]) > 10, done.stdout
