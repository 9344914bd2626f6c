"""Files are written in one place: `files/`, which replaces them whole and follows no link."""

from __future__ import annotations

import ast
from pathlib import Path

ROOT = Path(__file__).parents[2]
WRITERS = {"savefig", "write_text", "write_bytes", "copyfile", "copytree", "move", "rename", "dump", "tofile"}
# Names of our own modules with a `write_text`, and of the scratch file that `replace_file` yields.
OURS = {"records", "replacing", "scratch"}


def writes(path: Path) -> set[str]:
    """Returns the names of methods that write, of those that a file calls on anything but what is ours."""
    calls = [node.func for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call)]
    methods = [call for call in calls if isinstance(call, ast.Attribute) and call.attr in WRITERS]
    return {call.attr for call in methods if not (isinstance(call.value, ast.Name) and call.value.id in OURS)}


def opens(path: Path) -> bool:
    """Returns whether a file opens one by a mode that writes."""
    calls = [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call)]
    named = [call for call in calls if getattr(call.func, "attr", getattr(call.func, "id", "")) == "open"]
    words = [word.value for call in named for word in call.args if isinstance(word, ast.Constant)]
    return any(isinstance(word, str) and set(word) & set("wax") and len(word) <= 3 for word in words)


def test_no_other_place_writes_a_file():
    files = [path for room in ("ear_jax", "experiments", "benchmarks") for path in (ROOT / room).rglob("*.py")]
    found = {(path.relative_to(ROOT).as_posix(), word) for path in files for word in writes(path)}
    assert found == {("ear_jax/figures/style.py", "savefig")}, "into the scratch file"
    assert {path.relative_to(ROOT).as_posix() for path in files if opens(path)} == {
        "ear_jax/process/streams.py",  # the standard streams
        "ear_jax/runs/on_ray.py",  # a task's log, which its node appends to
        "ear_jax/runs/manifest.py",  # in a step that has no name yet
        "ear_jax/runs/safetensors.py",  # the scratch file
    }
