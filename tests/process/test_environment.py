"""The user's environment: one line names the variable that is at fault, and settings of JAX do not leak into runs."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import jax
import pytest

from ear_jax.errors import RunError
from ear_jax.process import environment, runtime
from ear_jax.runs.training import make_program
from tests.helpers.runs import tiny_config

WRONG = {
    "JAX_PLATFORMS": "cuda",
    "MUJOCO_GL": "nonsense",
    "JAX_ENABLE_X64": "1",
    "JAX_DEFAULT_PRNG_IMPL": "rbg",
}


def ear(*words: str, **variables: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "ear_jax.cli.main", *words]
    return subprocess.run(command, env={**os.environ, **variables}, capture_output=True, text=True, timeout=100)


def test_doctor_tells_all_that_is_wrong_with_the_environment():
    done = ear("doctor", "--json", **WRONG)
    assert done.returncode == 1
    problems = json.loads(done.stdout)["problems"]
    for name, value in WRONG.items():
        (told,) = (problem for problem in problems if problem.startswith(f"{name}={value} "))
        assert "unset" in told
    assert done.stderr.startswith("ear: 4 problems found: ")
    assert done.stderr.count("\n") == 1


@pytest.mark.slow
@pytest.mark.parametrize(("name", "value"), [*WRONG.items(), ("MUJOCO_GL", "osmesa"), ("JAX_DISABLE_JIT", "maybe")])
def test_every_command_names_the_variable_in_one_line(name, value):
    for words in ("evaluate pretrained:hopper-vel", "families", "train hopper-vel --dry-run", "demo --pretrained"):
        done = ear(*words.split(), **{name: value})
        assert (done.returncode, done.stdout) == (1, "")
        assert done.stderr.startswith(f"ear: {name}={value} does not work")
        assert done.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("name", "value"),
    [("jax_enable_x64", True), ("jax_default_prng_impl", "rbg"), ("jax_numpy_rank_promotion", "raise")],
)
def test_a_setting_of_jax_in_the_users_program_does_not_leak_into_a_run(name, value):
    before = getattr(jax.config, name)
    jax.config.update(name, value)
    try:
        with pytest.raises(RunError, match=f"{name} is .*; ear_jax needs jax.config.update"):
            make_program(tiny_config())
    finally:
        jax.config.update(name, before)
    environment.check_settings()


def test_a_failure_is_blamed_on_the_variable_that_it_names_or_that_is_set(monkeypatch):
    def fail() -> None:
        raise RuntimeError("Unable to initialize backend 'tpu'\nand more")

    monkeypatch.setattr(jax, "default_backend", fail)
    monkeypatch.delenv("JAX_PLATFORMS", raising=False)
    assert environment.problems() == ["JAX cannot start here: Unable to initialize backend 'tpu'"]
    monkeypatch.setenv("JAX_PLATFORMS", "tpu")
    (told,) = environment.problems()
    assert told.startswith("JAX_PLATFORMS=tpu does not work here (JAX: Unable to initialize backend 'tpu'); unset it")


def test_a_user_without_a_home_has_a_cache_only_where_a_variable_says(monkeypatch):
    monkeypatch.setattr(os.path, "expanduser", lambda path: path)  # as for a user that the system does not know
    for name in ("EAR_JAX_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    assert runtime.cache_dir() is None
    runtime.enable_cache()
    monkeypatch.setenv("EAR_JAX_CACHE", "/somewhere")
    assert str(runtime.cache_dir()) == "/somewhere/xla"


WITHOUT_HOME = """
import os, pwd, sys
def unknown(*_):
    raise KeyError("the system does not know this user")
pwd.getpwuid = pwd.getpwnam = unknown
os.environ.pop("HOME", None)
from ear_jax.cli.main import main
sys.exit(main(["evaluate", "pretrained:hopper-vel", "--episodes", "1"]))
"""


@pytest.mark.slow
def test_a_user_whom_the_system_does_not_know_evaluates(tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_HOME],
        env={**os.environ, "EAR_JAX_CACHE": str(tmp_path / "cache")},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=600,
    )
    assert (done.returncode, "Traceback" in done.stderr) == (0, False), done.stderr
