"""The words of a run and of `ear doctor` on precision and equal bits."""

from __future__ import annotations

from ear_jax.process.precision import equal_bits, numbers
from ear_jax.process.target import tracing_for
from ear_jax.runs.documents import header
from ear_jax.runs.training import make_program
from tests.helpers.runs import tiny_config


def test_equal_bits_are_promised_only_where_they_are_measured():
    assert equal_bits("native") == "equal seeds give equal bits"
    assert equal_bits("mjx") == "equal bits not measured with mjx"
    with tracing_for("gpu"):
        assert equal_bits("native") == equal_bits("mjx") == "equal bits not measured"
        assert numbers()["equal_bits"].startswith("not measured on ")
        assert numbers()["networks"].startswith("TF32")


def test_a_run_says_so_first():
    program = make_program(tiny_config())
    assert "engine native on cpu · equal seeds give equal bits · runs/a" in header(program, "runs/a")
    with tracing_for("gpu"):
        assert "engine native on cpu in TF32 · equal bits not measured · runs/a" in header(program, "runs/a")
