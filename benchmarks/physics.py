"""Env steps per second by engine, family and batch, compared with raw `mujoco.batch`, Gymnasium and Brax.

`ratio_to_raw` is the median ratio of paired runs from the same states with the same actions. Raw `mujoco.batch` steps
the same model equally often on equally many simulations and does nothing else. Gymnasium's environments and Brax's
`spring` start from their own states and reset robots that have fallen.
"""

from __future__ import annotations

import argparse
import copy
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from mujoco.batch import Batch

from benchmarks import common
from ear_jax.cli.exits import exit_code
from ear_jax.envs import FAMILIES, Family, make_family
from ear_jax.errors import RunError
from ear_jax.physics import Physics
from ear_jax.process import runtime

SHAPES = {
    10: (10, 1),
    80: (10, 8),
    512: (8, 64),
    640: (10, 64),
    8192: (8, 1024),
}  # batch → [tasks, envs] of the nested vmap
BATCHES = {  # batches to measure, by JAX backend and engine
    "cpu": {"native": (10, 80, 640), "mjx": (512,)},
    "gpu": {"mjx": (640, 8192), "warp": (640, 8192)},
}
ROBOTS = [name for name in FAMILIES if name != "reach"]  # reach is left out: a mocap body moves its arm
WARM_UP = 30  # random steps before the start, after which robots have fallen and have their usual contacts
OTHERS = {  # Gymnasium's and Brax's names for the robot of a family
    "halfcheetah-vel": ("HalfCheetah-v5", "halfcheetah"),
    "ant-dir": ("Ant-v5", "ant"),
    "hopper-vel": ("Hopper-v5", "hopper"),
    "walker-vel": ("Walker2d-v5", "walker2d"),
}


@dataclass(frozen=True)
class Case:
    """Initial states [batch, …] and actions [steps, batch, nu] that both contenders share; all float32."""

    family: str
    qpos: np.ndarray
    qvel: np.ndarray
    warmstart: np.ndarray
    actions: np.ndarray


def make_case(family: Family, batch: int, steps: int) -> Case:
    """Returns random starts advanced by some random steps of C MuJoCo, with random actions."""
    rng = np.random.default_rng(0)
    start = jax.device_get(jax.vmap(family.initial)(jax.random.split(jax.random.key(0), batch)))
    simulations = _simulations(family.model, start.qpos, start.qvel, start.warmstart)
    for controls in rng.uniform(-1, 1, (WARM_UP, batch, family.action_size)):
        simulations.ctrl[:] = controls
        simulations.step(nstep=family.substeps)
    fields = (simulations.qpos, simulations.qvel, simulations.qacc_warmstart)
    actions = rng.uniform(-1, 1, (steps, batch, family.action_size))
    return Case(family.name, *(field.astype(np.float32) for field in (*fields, actions)))


def raw_run(family: Family, case: Case) -> Callable[[], None]:
    """Returns a call that plays the case on `mujoco.batch` alone."""
    simulations = _simulations(family.model, case.qpos, case.qvel, case.warmstart)
    start, controls = simulations.state.copy(), case.actions.astype(np.float64)

    def run() -> None:
        simulations.state[:] = start
        for control in controls:
            simulations.ctrl[:] = control
            simulations.step(nstep=family.substeps)
        _check(simulations.qpos)

    return run


def engine_run(family: Family, case: Case) -> Callable[[], None]:
    """Returns a call that plays the case on the family's engine as in training: inside jit, scan and two vmaps."""
    tasks_envs = SHAPES[len(case.qpos)]

    def step(physics: Physics, action: jax.Array) -> tuple[Physics, None]:
        return jax.vmap(jax.vmap(family.engine.step))(physics, action).after, None

    @jax.jit(compiler_options=runtime.compiler_options())
    def roll(physics: Physics, actions: jax.Array) -> Physics:
        return jax.lax.scan(step, physics, actions)[0]

    fields = (case.qpos, case.qvel, case.warmstart)
    start = Physics(*(jnp.asarray(field).reshape(*tasks_envs, -1) for field in fields))
    actions = jnp.asarray(case.actions).reshape(len(case.actions), *tasks_envs, -1)
    return lambda: _check(roll(start, actions).qpos)


def measure(options: argparse.Namespace, engine: str, name: str, batch: int, steps: int, repeats: int) -> None:
    """Writes two rows: raw, and an engine paired with it."""
    try:
        family = make_family(name, engine)
    except RunError as error:
        common.write_row(options, "physics", {"engine": engine, "family": name, "unavailable": str(error)})
        return
    case = make_case(family, batch, steps)
    timings = common.alternate({"raw": raw_run(family, case), engine: engine_run(family, case)}, repeats)
    for contender, timing in timings.items():
        row = {
            "engine": contender,
            "family": name,
            "batch": batch,
            "steps": steps,
            "repeats": repeats,
            "beside": engine,
            "positions": contender == engine and bool(family.bodies),  # body positions, which raw does not compute
            **common.spread("env_steps_per_second", [batch * steps / value for value in timing.seconds]),
            **common.spread("ratio_to_raw", common.ratios(timings["raw"].seconds, timing.seconds)),
            **common.spread("cores_used", timing.cores),
        }
        common.write_row(options, "physics", row)


def measure_others(options: argparse.Namespace, kind: str, name: str, *sizes: int) -> None:
    """Writes rows of another project's environments, measured in a process of their own."""
    robot = OTHERS[name][kind == "spring"]
    words = [sys.executable, "-m", "benchmarks.physics_others", kind, robot, *map(str, sizes)]
    environment = {**os.environ, "PYTHONPATH": str(common.RESULTS.parents[1])}
    with tempfile.TemporaryDirectory() as scratch:  # for MuJoCo's log about Gymnasium's old models
        done = subprocess.run(words, capture_output=True, text=True, cwd=scratch, env=environment)
    if done.returncode:
        reason = (done.stderr.strip().splitlines() or ["no reason given"])[-1]
        common.write_row(options, "physics", {"engine": kind, "family": name, "unavailable": reason})
        return
    for row in json.loads(done.stdout.splitlines()[-1]):
        common.write_row(options, "physics", {"family": name, **row})


def _simulations(model: mujoco.MjModel, qpos: np.ndarray, qvel: np.ndarray, warmstart: np.ndarray) -> Batch:
    model = copy.copy(model)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET  # as in the native engine
    simulations = Batch(model, len(qpos))
    simulations.qpos[:], simulations.qvel[:], simulations.qacc_warmstart[:] = qpos, qvel, warmstart
    return simulations


def _check(qpos: np.ndarray | jax.Array) -> None:
    """Waits for the result and checks that it is finite: simulations that diverged are cheaper to step."""
    if not np.isfinite(np.asarray(qpos)).all():
        raise RuntimeError("a simulation diverged: its positions are not finite")


def main() -> None:
    options = common.arguments(__doc__)
    if options.quick:
        for name in ROBOTS:
            measure(options, "native", name, 640, steps=5, repeats=2)
        measure(options, "mjx", "halfcheetah-vel", 512, steps=2, repeats=1)
        measure_others(options, "gymnasium", "ant-dir", 16, 10, 1)
        measure_others(options, "spring", "halfcheetah-vel", 512, 2, 1)
        return
    for name in ROBOTS:
        for engine, batches in BATCHES[jax.default_backend()].items():
            for batch in batches:
                size = (max(50, 8000 // batch), 5) if engine == "native" else (10, 3)
                measure(options, engine, name, batch, *size)
    for name in OTHERS:
        measure_others(options, "gymnasium", name, 16, 500, 5)
        measure_others(options, "spring", name, 512, 20, 3)


if __name__ == "__main__":
    sys.exit(exit_code("physics", main))
