"""No data read from disk is run as code: no pickle, no eval, no import by a name in a file."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

import ear_jax

PACKAGE = Path(ear_jax.__file__).parent
MODULES = {
    "pickle",
    "cPickle",
    "dill",
    "cloudpickle",
    "joblib",
    "marshal",
    "shelve",
    "yaml",
    "torch",
    "runpy",
    "tarfile",
}
MODULES |= {"zipfile", "msgpack", "numpy.lib.format"}
CALLS = {"eval", "exec", "compile", "__import__", "import_module", "exec_module", "load_module", "fromfile"}
CALLS |= {"spec_from_file_location", "allow_pickle", "extractall", "unpack_archive", "entry_points"}
# Imports by a name that the user typed, or that this package holds.
ALLOWED = {
    ("cli/main.py", "import_module"),  # a command, out of a table
    ("cli/completion.py", "import_module"),  # all commands of that table
    ("rendering/scene.py", "import_module"),  # one of MuJoCo's two ways to OpenGL
    ("rendering/live/wasm.py", "tarfile"),  # two members read, not extracted, of an archive whose hash is pinned
    ("__init__.py", "import_module"),  # a public name, a family, a method: each from a list in that file
    ("envs/registry.py", "import_module"),
    ("methods/__init__.py", "import_module"),
    ("envs/registry.py", "spec_from_file_location"),  # a family, named on the command line
    ("envs/registry.py", "exec_module"),
    ("names.py", "entry_points"),  # a family that an installed package offers
}
OURS = {  # the methods of MuJoCo's specifications and of JAX's programs
    ("physics/models.py", "compile"),
    ("physics/sawyer.py", "compile"),
    ("runs/on_host.py", "compile"),
}


def words_of(path: Path) -> set[str]:
    """Returns every module a file imports, and every function and keyword it calls."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            found |= {node.module or ""} | {alias.name for alias in node.names}
        elif isinstance(node, ast.Call):
            found |= {node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")}
            found |= {keyword.arg or "" for keyword in node.keywords}
    return found


def test_no_file_of_ours_can_turn_data_into_code():
    files = list(PACKAGE.rglob("*.py"))
    assert len(files) > 50
    found = {(path.relative_to(PACKAGE).as_posix(), word) for path in files for word in words_of(path)}
    assert {(path, word) for path, word in found if word in MODULES | CALLS} - ALLOWED - OURS == set()
    assert found >= ALLOWED | OURS, "a place that is gone is allowed no longer"


GUARD = """
import os, sys
def guard(event, arguments):
    if event == "pickle.find_class" or (event == "open" and str(arguments[0]).endswith(".pkl")):
        os.write(2, f"{event} {arguments}".encode())
        os._exit(99)
sys.addaudithook(guard)
"""
READING = """
sys.path.insert(0, sys.argv[1])
from pathlib import Path
from tests.helpers.runs import finished_config
from tests.helpers.runs import last_state
from ear_jax.runs import checkpoint, trained
run = Path(sys.argv[2])
said = []
step = checkpoint.newest(run / "checkpoints", said.append)
assert step.epoch == 18 and "state/planted.pkl is not in its manifest SHA256SUMS" in said[0], said
checkpoint.save(run / "checkpoints", 20, last_state(run, finished_config(), said.append), step.about)
assert trained.load(run).epoch == 20
"""


def guarded(code: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Runs code under a guard: Python reports every class unpickled and every file opened by any library."""
    return subprocess.run([sys.executable, "-c", GUARD + code, *arguments], capture_output=True, text=True, timeout=600)


def test_saving_and_restoring_unpickle_nothing_and_never_open_a_planted_pickle(finished):
    for place in (finished, finished / "checkpoints", finished / "checkpoints" / "24" / "state"):
        (place / "planted.pkl").write_bytes(b"cos\nsystem\n(S'true'\ntR.")
    done = guarded(READING, str(Path(__file__).parents[2]), str(finished))
    assert done.returncode == 0, done.stderr


def test_the_guard_sees_a_pickle(tmp_path):
    import pickle

    (tmp_path / "data").write_bytes(pickle.dumps(os.getcwd))
    assert guarded("import pickle; pickle.load(open(sys.argv[1], 'rb'))", str(tmp_path / "data")).returncode == 99
    (tmp_path / "a.pkl").touch()
    assert guarded("open(sys.argv[1])", str(tmp_path / "a.pkl")).returncode == 99


def test_the_compilation_cache_is_the_users_alone(tmp_path, monkeypatch):
    from ear_jax.process import runtime

    settings = {"jax_compilation_cache_dir": None}
    fake = type("Config", (), {**settings, "update": lambda self, name, value: settings.update({name: value})})()
    monkeypatch.setattr(runtime.jax, "config", fake)
    monkeypatch.setenv("EAR_JAX_CACHE", str(tmp_path / "cache"))
    runtime.enable_cache()
    assert settings["jax_compilation_cache_dir"] == str(tmp_path / "cache" / "xla")
    assert (tmp_path / "cache" / "xla").stat().st_mode & 0o777 == 0o700
    settings["jax_compilation_cache_dir"] = None
    monkeypatch.setattr(os, "getuid", lambda: 12345)
    runtime.enable_cache()
    assert settings["jax_compilation_cache_dir"] is None, "another's directory is not trusted"


@pytest.mark.parametrize("name", ["metrics.jsonl", "evaluation.json.part"])
def test_a_link_planted_in_a_run_is_not_written_through(name, tmp_path):
    from ear_jax.errors import RunError
    from ear_jax.runs import records

    victim = tmp_path / "victim"
    victim.write_text("precious")
    (tmp_path / name).symlink_to(victim)
    if name == "metrics.jsonl":
        with pytest.raises(RunError, match="cannot write"):
            records.append_rows(tmp_path / name, [{"epoch": 1}])
    else:
        records.write_json(tmp_path / "evaluation.json", {})
    assert victim.read_text() == "precious"
