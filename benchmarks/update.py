"""Wall time of one gradient update, without collection, compared with its bare matmuls.

The matmuls are read from the traced update, so that their shapes follow the networks. `ratio_to_matmuls` is the median
ratio of paired runs.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax.extend.core import Jaxpr, jaxprs_in_params

from benchmarks import common
from ear_jax.cli.exits import exit_code
from ear_jax.learning.replay import Replay
from ear_jax.learning.sac import Draws
from ear_jax.learning.sac_state import SacState
from ear_jax.presets import preset_config
from ear_jax.process import runtime
from ear_jax.runs import training
from ear_jax.runs.training import Program


@dataclass(frozen=True)
class Matmul:
    """One dot product of an update, in the terms of JAX's `dot_general`."""

    left: tuple[int, ...]
    right: tuple[int, ...]
    dimensions: Any  # (contracting, batch), each a pair of tuples of axes

    @property
    def flop(self) -> int:
        (contracting, _), (batch, _) = self.dimensions
        shared = math.prod(self.left[axis] for axis in (*contracting, *batch))
        inner = math.prod(self.left[axis] for axis in contracting)
        batches = math.prod(self.left[axis] for axis in batch)
        return 2 * inner * batches * (math.prod(self.left) // shared) * (math.prod(self.right) // shared)


def find_matmuls(jaxpr: Jaxpr) -> Iterator[Matmul]:
    """Yields all dot products of a traced program without loops."""
    for equation in jaxpr.eqns:
        if equation.primitive.name == "dot_general":
            left, right = (operand.aval.shape for operand in equation.invars)
            yield Matmul(left, right, equation.params["dimension_numbers"])
        for inner in jaxprs_in_params(equation.params):
            yield from find_matmuls(inner)


def filled(program: Program, key: jax.Array) -> training.TrainState:
    """Returns a fresh run with a replay full of noise: the time of an update does not depend on the data."""
    state = training.init(program, key)

    def noise(ring: jax.Array) -> jax.Array:
        return jnp.zeros_like(ring) if ring.dtype == bool else jax.random.normal(key, ring.shape, ring.dtype)

    rings = jax.tree.map(noise, state.replay.rings)
    return dataclasses.replace(
        state, replay=Replay(rings, jnp.full_like(state.replay.added, rings.terminated.shape[1]))
    )


def updated(program: Program, updates: int, learner: SacState, buffer: Replay, key: jax.Array) -> SacState:
    """Returns one seed's learner after some updates."""
    draws = program.learner.draw(key, updates)
    return jax.lax.scan(lambda learner, draws: program.learner.update(learner, buffer, draws), learner, draws)[0]


def update_run(program: Program, state: training.TrainState, updates: int) -> Any:
    """Returns a call that makes the updates of an epoch for all seeds; leaves of `state` are [seeds, …]."""
    options = runtime.compiler_options(program.config.network.matmul)
    run = jax.jit(jax.vmap(partial(updated, program, updates)), compiler_options=options)
    return lambda: jax.block_until_ready(run(state.learner, state.replay, state.key))


def matmul_run(matmuls: list[Matmul], updates: int) -> Any:
    """Returns a call that makes the matmuls of `updates` updates and nothing else.

    Each round calls one compiled program. In a loop, XLA would hoist operations that do not change between rounds; if
    rounds are made to differ, it copies operands, which took up to half as long as the matmuls. The products of a round
    reuse the memory of the previous ones, as an update's arrays are updated in place too.
    """
    keys = jax.random.split(jax.random.key(0), 2 * len(matmuls)).reshape(len(matmuls), 2)
    operands = [
        (jax.random.normal(left, matmul.left), jax.random.normal(right, matmul.right))
        for matmul, (left, right) in zip(matmuls, keys, strict=True)
    ]

    def multiply(operands: Any, before: Any) -> list[jax.Array]:
        del before  # donated: its memory is reused for the products
        sides = zip(matmuls, operands, strict=True)
        return [jax.lax.dot_general(left, right, matmul.dimensions) for matmul, (left, right) in sides]

    options = runtime.compiler_options()
    compiled = jax.jit(multiply, donate_argnums=1, keep_unused=True, compiler_options=options)
    products = jax.jit(multiply)(operands, None)

    def run() -> None:
        nonlocal products
        for _ in range(updates):
            products = compiled(operands, products)
        jax.block_until_ready(products)

    return run


def measure(options: argparse.Namespace, preset: str, seeds: int, updates: int, repeats: int) -> None:
    config = dataclasses.replace(preset_config("halfcheetah-vel", preset), seeds=seeds)
    program = training.make_program(config)
    state = jax.jit(jax.vmap(partial(filled, program)))(training.seed_keys(config))
    matmuls = list(find_matmuls(jax.make_jaxpr(partial(_first_update, program))(state).jaxpr))
    contenders = {"update": update_run(program, state, updates), "matmuls": matmul_run(matmuls, updates)}
    timings = common.alternate(contenders, repeats)
    update, bare = timings["update"], timings["matmuls"]
    flop = sum(matmul.flop for matmul in matmuls)
    row = {
        "preset": preset,
        "family": config.family,
        "seeds": seeds,
        "backend": jax.default_backend(),
        "width": config.network.width,
        "batch_size": config.sac.batch_size,
        "updates": updates,
        "repeats": repeats,
        "matmuls": len(matmuls),
        "gflop": round(flop / 1e9, 4),
        **common.spread("update_ms", [1e3 * value / updates for value in update.seconds]),
        **common.spread("matmuls_ms", [1e3 * value / updates for value in bare.seconds]),
        **common.spread("ratio_to_matmuls", common.ratios(update.seconds, bare.seconds)),
        **common.spread("cores_used", update.cores),
    }
    common.write_row(options, "update", row)


def _first_update(program: Program, state: training.TrainState) -> SacState:
    def one_seed(learner: SacState, buffer: Replay, key: jax.Array) -> SacState:
        draws: Draws = jax.tree.map(lambda leaf: leaf[0], program.learner.draw(key, 1))
        return program.learner.update(learner, buffer, draws)[0]

    return jax.vmap(one_seed)(state.learner, state.replay, state.key)


def main() -> None:
    options = common.arguments(__doc__)
    for preset in ("fast", "paper"):
        for seeds in (1, 2):
            measure(options, preset, seeds, *((2, 2) if options.quick else (20, 7)))


if __name__ == "__main__":
    sys.exit(exit_code("update", main))
