"""The count of kernels: of a text with known answers, of traced programs, and of those compiled for a GPU."""

from __future__ import annotations

import dataclasses
import os
from collections import Counter
from functools import partial

import jax
import pytest
from jax.extend.core import Jaxpr, jaxprs_in_params

from benchmarks import census, common, hlo
from ear_jax.presets import preset_config
from ear_jax.process.target import tracing_for
from ear_jax.runs import records, training

TEXT = """
HloModule jit_learn, is_scheduled=true

%fused_gather (p: f32[100,4], i: s32[8,1]) -> f32[8,4] {
  %p = f32[100,4]{1,0} parameter(0)
  %i = s32[8,1]{1,0} parameter(1)
  ROOT %g = f32[8,4]{1,0} gather(%p, %i), offset_dims={1}, metadata={op_name="jit(learn)/while/body/gather"}
}

%fused_dot (a: f32[8,4], b: f32[4,4]) -> f32[8,4] {
  %a = f32[8,4]{1,0} parameter(0)
  %b = f32[4,4]{1,0} parameter(1)
  ROOT %d = f32[8,4]{1,0} dot(%a, %b), lhs_contracting_dims={1}, metadata={op_name="jvp(vmap(vmap(_Mlp)))/Dense_0/dot"}
}

%inner (s: (s32[], f32[8,4])) -> (s32[], f32[8,4]) {
  %s = (s32[], f32[8,4]{1,0}) parameter(0)
  %x = f32[8,4]{1,0} get-tuple-element(%s), index=1
  %m = f32[8,4]{1,0} multiply(%x, %x), metadata={op_name="jit(learn)/while/body/while/body/mul"}
  ROOT %t = (s32[], f32[8,4]{1,0}) tuple(%c, %m)
}

%body (s: (s32[], f32[8,4])) -> (s32[], f32[8,4]) {
  %s = (s32[], f32[8,4]{1,0}) parameter(0)
  %rings = f32[100,4]{1,0} get-tuple-element(%s), index=1
  %slots = s32[8,1]{1,0} get-tuple-element(%s), index=2
  %batch = f32[8,4]{1,0} fusion(%rings, %slots), kind=kLoop, calls=%fused_gather
  %w = f32[4,4]{1,0} get-tuple-element(%s), index=3
  %q = f32[8,4]{1,0} fusion(%batch, %w), kind=kCustom, calls=%fused_dot
  %loop = (s32[], f32[8,4]{1,0}) while(%q), condition=%c1, body=%inner, backend_config={"known_trip_count":{"n":"3"}}
  %wait = (s32[], f32[8,4]{1,0}) while(%q), condition=%c2, body=%inner
  ROOT %t = (s32[], f32[8,4]{1,0}) tuple(%q, %q)
}

ENTRY %main (s: (s32[], f32[8,4])) -> (s32[], f32[8,4]) {
  %s = (s32[], f32[8,4]{1,0}) parameter(0)
  ROOT %all = (s32[], f32[8,4]{1,0}) while(%s), condition=%c, body=%body, backend_config={"known_trip_count":{"n":"4"}}
}
"""


def test_kernels_traffic_and_waits_of_a_known_text():
    """Gathers read what they write, inner loops count each time round, and one of them waits for the device."""
    array = 4 * 8 * 4
    counted = census.count(TEXT)
    assert counted["kernels"] == 2 + 3 + 1
    assert counted["matmuls"] == 1
    assert counted["parts"] == {"other": 4, "gathered batch": 1, "critics forward": 1}
    assert (counted["host_reads"], counted["scatters"]) == (1, 0)
    assert census.count(TEXT, rounds=5)["kernels"] == 2 + 3 + 5, "the loop of unknown length counts as often as told"
    (gather, dot, *_) = hlo.parse(TEXT).kernels("body")
    assert (gather.traffic, dot.traffic) == (2 * array, 2 * array + 4 * 4 * 4)
    assert hlo.size("(f32[2,3]{1,0}, s32[], pred[8], token[])") == 24 + 4 + 8


LISTING = """
000: kCommandBuffer [source | next=002 (1)]
    001: kCustomKernel [source | sink] before
002: kWhile         [prev=000 (1) | sink]
condition:
    003: kCustomKernel [source | sink] compare
  body:
    000: kCommandBuffer [source | next=006 (1)]
        004: kCustomKernel [source | sink] first
        005: kCopy         [source | sink] kCopy
    006: kWhile         [prev=000 (1) | sink]
condition:
        007: kCustomKernel [source | sink] compare
      body:
        008: kCustomCall   [source | next=000 (1)] kCustomCall
        000: kCommandBuffer [prev=008 (1) | sink]
            009: kCustomKernel [source | sink] second
    010: kCopy          [prev=006 (1) | sink] kCopy
000: kCommandBuffer [prev=002 (1) | sink]
    011: kCustomKernel [source | sink] after
"""


def test_graphs_of_a_known_listing():
    """Of the loop: two graphs, and outside of them the inner loop, a library's call in it and a copy."""
    assert census.graphs_of(LISTING) == {"graphs": 2, "loose": 3}


def operations(jaxpr: Jaxpr) -> Counter:
    """Counts the operations of a traced program; those of a loop once."""
    found: Counter = Counter()
    for equation in jaxpr.eqns:
        found[equation.primitive.name] += 1
        for inner in jaxprs_in_params(equation.params):
            found += operations(inner)
    return found


def test_learning_on_a_gpu_does_not_grow():
    """Traced only: operations in all and of the costly kinds, of an epoch whose updates count once, and no scatter."""
    config = dataclasses.replace(preset_config("halfcheetah-vel", "fast"), engine="native")
    with tracing_for("gpu"):
        program = training.make_program(config)
        state = jax.eval_shape(partial(training.init, program), jax.random.key(0))
        found = operations(jax.make_jaxpr(partial(training.learn, program))(state).jaxpr)
    assert found["scatter-add"] == found["scatter"] == 0
    assert found.total() <= 2250
    assert found["dot_general"] == 40


def last_rows():
    """The last committed row of each program and engine, of those of XLA's kernels alone."""
    rows = records.read_rows(common.RESULTS / "census.jsonl")
    return {(row["program"], census.engine_of(row)): row for row in rows if row["kernels_by"] == "xla"}


@pytest.mark.slow
@pytest.mark.skipif(census.missing() is not None, reason=str(census.missing()))
@pytest.mark.skipif(os.environ.get("JAX_PLATFORMS") != "cpu", reason="without JAX_PLATFORMS=cpu the plugin needs a GPU")
@pytest.mark.parametrize(
    ("program", "engine"), [("learn", "native"), ("collect", "mjx"), ("evaluate", "mjx"), ("collect", "mjx-fixed")]
)
def test_kernels_compiled_for_an_h100_do_not_grow(program, engine):
    """Of an update, and of a step on MJX, against the last committed row."""
    row = last_rows()[program, engine]
    counted = census.counted(row)
    assert counted["kernels"] <= row["kernels"]
    assert counted["traffic_mb"] <= 1.01 * row["traffic_mb"]
    assert counted["host_reads"] <= row["host_reads"]
    assert counted["scatters"] <= row["scatters"]


def test_neither_learning_nor_the_fixed_solver_waits_for_the_host():
    rows = last_rows()
    assert rows["learn", "native"]["scatters"] == 0
    assert [row["host_reads"] for row in rows.values()] == [0, 1, 1, 0]
    assert rows["collect", "mjx-fixed"]["kernels"] < 0.6 * rows["collect", "mjx"]["kernels"]
