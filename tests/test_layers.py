"""Imports go one way, and what reads records never waits for JAX."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import ear_jax

PACKAGE = Path(ear_jax.__file__).parent
# From the bottom up; a module may import only from rows above its own, or from its own package.
LAYERS = [
    {"errors", "quiet", "stopping"},
    {"config", "matmul"},
    {
        "records",
        "manifest",
        "lock",
        "safetensors",
        "leaves",
        "tasks",
        "physics",
        "networks",
        "policy",
        "belief",
        "advantage",
        "trust_region",
    },
    {"presets", "runtime", "terminal", "checkpoint", "export", "directory", "failure", "report", "ltes", "pretrained"},
    {"envs", "agents", "stage"},
    {"grid", "codes", "seeds"},
    {"cem"},
    {"rollout", "replay"},
    {"losses"},
    {"learner", "maml"},
    {"train"},
    {"trained"},
    {"evaluate", "trajectory"},
    {"atlas", "interpolate", "sensing", "render", "estimate", "search"},
    {"adapt", "compose", "explore"},
    {"run"},
    {"cli"},
]
RANK = {module: rank for rank, row in enumerate(LAYERS) for module in row}


def imports(path: Path) -> set[str]:
    """The modules of ours that a file imports, by their first name below the package."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] == "ear_jax":
            parts = node.module.split(".")[1:]
            found |= {parts[0]} if parts else {alias.name for alias in node.names}
        elif isinstance(node, ast.Import):
            found |= {alias.name.split(".")[1] for alias in node.names if alias.name.startswith("ear_jax.")}
    return found


def test_imports_go_one_way():
    files = [path for path in PACKAGE.rglob("*.py") if path.relative_to(PACKAGE) != Path("__init__.py")]
    assert len(files) > 25
    for path in files:
        mine = path.relative_to(PACKAGE).parts[0].removesuffix(".py")
        for other in imports(path) - {mine}:
            assert RANK[other] < RANK[mine], f"{path.name} may not import {other}"


def test_reports_and_the_list_of_pretrained_agents_do_not_import_jax():
    code = "import sys, ear_jax.records, ear_jax.report.figures, ear_jax.cli.pretrained; print('jax' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
