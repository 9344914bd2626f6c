"""Imports go one way, rooms stay small, and readers of records never import JAX."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import ear_jax

PACKAGE = Path(ear_jax.__file__).parent
# From the bottom up. A package may import only from those before it; so may the modules beside them.
ORDER = (
    "errors",
    "names",
    "gymnasium_ids",
    "config",
    "limits",
    "tasks",
    "files",
    "config_files",
    "process",
    "physics",
    "envs",
    "agents",
    "learning",
    "methods",
    "presets",
    "pretrained",
    "runs",
    "embeddings",
    "figures",
    "rendering",
    "cli",
)
RANK = {name: rank for rank, name in enumerate(ORDER)}
FILES = [path for path in PACKAGE.rglob("*.py") if path != PACKAGE / "__init__.py"]


def imports(path: Path) -> set[str]:
    """Returns the modules of this package that a file imports, at any place in it."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] == "ear_jax":
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names if alias.name.startswith("ear_jax.")}
    return found


def module_of(path: Path) -> str:
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def room(module: str) -> str:
    return module.split(".")[1]


def test_imports_go_one_way():
    for path in FILES:
        mine = room(module_of(path))
        for other in {room(module) for module in imports(path)} - {mine}:
            assert RANK[other] < RANK[mine], f"{path.name} may not import {other}"


def test_no_module_imports_itself_round_a_circle():
    modules = {module_of(path): path for path in FILES}

    def named(imported: str) -> str | None:
        """Returns the module that an import names, or the one that defines the imported name."""
        return imported if imported in modules else next(iter({imported.rpartition(".")[0]} & modules.keys()), None)

    arrows = {
        module: {found for found in map(named, imports(path)) if found} - {module} for module, path in modules.items()
    }
    while free := [module for module, others in arrows.items() if not others & arrows.keys()]:
        for module in free:
            del arrows[module]
    assert not arrows, f"a circle among {sorted(arrows)}"


def test_rooms_files_and_functions_stay_small():
    assert len(list(PACKAGE.glob("*.py"))) - 1 <= 10
    for path in FILES:
        text = path.read_text()
        assert text.count("\n") <= 300, path
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.FunctionDef):
                assert (node.end_lineno or 0) - node.lineno < 60, f"{path}: {node.name}"


def test_records_figures_and_the_list_of_pretrained_agents_do_not_import_jax():
    modules = ("ear_jax.runs.records", "ear_jax.figures.evaluate", "ear_jax.cli.pretrained")
    code = f"import sys, {', '.join(modules)}; print('jax' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def test_a_command_on_a_shipped_agent_imports_only_what_it_uses():
    """Brax, MJX, Orbax and matplotlib take a third of the CPU time of `ear evaluate`, and it uses only the last."""
    heavy = ("brax", "mujoco.mjx", "orbax", "matplotlib", "trimesh", "scipy", "warp")
    code = f"""
import sys
from pathlib import Path
import ear_jax.cli.evaluate
from ear_jax.runs.trained import load
assert load(Path("pretrained:halfcheetah-vel")).program.family.engine.name == "native"
print([name for name in {heavy} if name in sys.modules])
import brax.envs
print(type(brax.envs.get_environment("ear_halfcheetah_vel")).__name__)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    ours, *_, environment = done.stdout.splitlines()  # Brax adds lines of its own
    assert (ours, environment) == ("[]", "HalfCheetahVel")
