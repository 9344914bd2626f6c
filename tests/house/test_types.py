"""Types of the public interface, as a user's type checker sees them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PROGRAM = """
from pathlib import Path

import jax.numpy as jnp

import ear_jax

config = ear_jax.preset_config("hopper-vel", "fast")
ear_jax.train_run(config, Path("run"))
trained = ear_jax.load(Path("run"))
reveal_type(trained)
reveal_type(ear_jax.blend(jnp.zeros(3), jnp.ones(3), jnp.float32(0.5), trained.program.agent.project))
reveal_type(ear_jax.make_family("hopper-vel").action_size)
reveal_type(config.sac.lr)
ear_jax.train_run(config, 3)
"""


def test_the_package_says_that_it_has_types():
    assert (ROOT / "ear_jax" / "py.typed").is_file()


@pytest.mark.slow
def test_a_users_program_is_checked_strictly(tmp_path):
    (tmp_path / "program.py").write_text(PROGRAM)
    command = [sys.executable, "-m", "mypy", "--strict", "--cache-dir", str(tmp_path / "cache"), "program.py"]
    environment = {"PATH": "", "MYPYPATH": str(ROOT), "HOME": str(tmp_path)}
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=900)
    own = [line for line in done.stdout.splitlines() if line.startswith("program.py")]
    revealed = [line.split('"')[1].rpartition(".")[2] for line in own if "Revealed" in line]
    assert revealed == ["Trained", "Array", "int", "float"], done.stdout[-2000:]
    (wrong,) = [line for line in own if "error" in line]
    assert 'incompatible type "int"; expected "Path"' in wrong
