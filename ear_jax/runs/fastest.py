"""The faster of the engines that an accelerator's machine has: C MuJoCo on its cores, or MJX on the device."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace

import jax
import jax.numpy as jnp

from ear_jax.config import Config
from ear_jax.envs.batched_env import BatchedEnv, EnvState
from ear_jax.methods import find_method
from ear_jax.process.target import on_accelerator, tracing_for
from ear_jax.process.terminal import phase
from ear_jax.runs import training
from ear_jax.runs.on_host import host_device

SECONDS = 1.0  # of stepping, after compiling
CANDIDATES = ("native", "mjx")


def with_engine(config: Config, tell: Callable[[str], None]) -> Config:
    """Returns the settings with the engine that `auto` means on an accelerator, the one that steps faster there.

    Args:
      config: the run's settings.
      tell: called with a line that says which engine was taken and why.
    """
    if config.engine != "auto" or not on_accelerator() or find_method(config.agent).learner.on_policy:
        return config
    with phase("timing engines"):
        engine, line = fastest_engine({name: step_seconds(config, name) for name in CANDIDATES})
    tell(line)
    return replace(config, engine=engine)


def step_seconds(config: Config, engine: str) -> float:
    """Returns the seconds in which an engine steps all environments of a run once."""
    native = engine == "native"
    with tracing_for("cpu") if native else nullcontext():
        program = training.make_program(replace(config, engine=engine))
        batched, size = (
            BatchedEnv(program.family),
            (len(program.tasks), config.collect.envs, program.family.action_size),
        )

        def start(key: jax.Array) -> EnvState:
            return batched.start(key, program.tasks.params, config.collect.envs)

        def step(cells: EnvState) -> EnvState:
            return batched.step(cells, jnp.zeros(size))[0]

        keys = training.seed_keys(config)
        keys = jax.device_put(keys, host_device()) if native else keys
        cells, run = jax.jit(jax.vmap(start))(keys), jax.jit(jax.vmap(step))
        cells = jax.block_until_ready(run(cells))
        began, steps = time.perf_counter(), 0
        while time.perf_counter() - began < SECONDS:
            cells, steps = jax.block_until_ready(run(cells)), steps + 1
    return (time.perf_counter() - began) / steps


def fastest_engine(seconds: dict[str, float]) -> tuple[str, str]:
    """Returns the engine of the least seconds a step, and a line that tells them."""
    best = min(seconds, key=seconds.__getitem__)
    told = ", ".join(f"{engine} {1e3 * value:.2f} ms" for engine, value in seconds.items())
    return best, f"engine {best}: a step of all environments takes {told}"
