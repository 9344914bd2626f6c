"""Gymnasium's vector environments and Brax's `spring` pipeline; started by `benchmarks.physics`.

    python -m benchmarks.physics_others gymnasium|spring ROBOT BATCH STEPS REPEATS

It is a separate process because Gymnasium forks its workers, which is unsafe in a process that runs JAX. Prints a JSON
list.
"""

from __future__ import annotations

import argparse
import json
import sys
import types
from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks import common
from ear_jax.cli.exits import exit_code


def gymnasium_rows(robot: str, batch: int, steps: int, repeats: int) -> list[dict[str, Any]]:
    """Times synchronous and asynchronous vector environments, paired with raw `mujoco.batch` from the default pose."""
    import gymnasium

    try:
        import imageio  # noqa: F401
    except ModuleNotFoundError:  # Gymnasium imports it only to save pictures from its viewer
        sys.modules["imageio"] = types.ModuleType("imageio")
    settings: dict[str, Any] = {"include_cfrc_ext_in_observation": False} if robot.startswith("Ant") else {}
    actions = np.random.default_rng(0).uniform(-1, 1, (steps, batch, 8))
    vectors: dict[str, Any] = {
        f"gymnasium-{mode}": gymnasium.make_vec(robot, num_envs=batch, vectorization_mode=mode, **settings)
        for mode in ("sync", "async")
    }
    single: Any = vectors["gymnasium-sync"].envs[0].unwrapped
    actions = actions[..., : single.model.nu].astype(np.float32)
    contenders = {
        "raw": _raw(single.model, single.frame_skip, actions),
        **{name: _vector(environments, actions) for name, environments in vectors.items()},
    }
    timings = common.alternate(contenders, repeats)
    for environments in vectors.values():
        environments.close()
    return [
        {
            "engine": name,
            **_sizes(batch, steps, repeats, timings[name].seconds),
            **common.spread("ratio_to_raw", common.ratios(timings["raw"].seconds, timings[name].seconds)),
        }
        for name in vectors
    ]


def spring_rows(robot: str, batch: int, steps: int, repeats: int) -> list[dict[str, Any]]:
    """Times Brax's own pipeline: a coarser physics of the same robot, without automatic resets."""
    import jax

    from ear_jax.process import runtime, silent_imports  # noqa: F401  imports Brax without its line on stdout

    from brax.envs import get_environment  # isort: skip

    environment = get_environment(robot, backend="spring")
    actions = jax.random.uniform(jax.random.key(0), (steps, batch, environment.action_size), minval=-1)

    def step(state: Any, action: jax.Array) -> tuple[Any, None]:
        return jax.vmap(environment.step)(state, action), None

    roll = jax.jit(lambda state: jax.lax.scan(step, state, actions)[0].obs, compiler_options=runtime.compiler_options())
    start = jax.jit(jax.vmap(environment.reset))(jax.random.split(jax.random.key(1), batch))
    timings = common.alternate({"spring": lambda: jax.block_until_ready(roll(start))}, repeats)
    return [{"engine": "spring", **_sizes(batch, steps, repeats, timings["spring"].seconds)}]


def _vector(environments: Any, actions: np.ndarray) -> Callable[[], None]:
    def run() -> None:
        environments.reset(seed=0)
        for action in actions:
            environments.step(action)

    return run


def _raw(model: Any, substeps: int, actions: np.ndarray) -> Callable[[], None]:
    from mujoco.batch import Batch

    simulations = Batch(model, actions.shape[1])
    controls = actions.astype(np.float64)

    def run() -> None:
        simulations.reset()
        for control in controls:
            simulations.ctrl[:] = control
            simulations.step(nstep=substeps)

    return run


def _sizes(batch: int, steps: int, repeats: int, seconds: list[float]) -> dict[str, Any]:
    rates = [batch * steps / value for value in seconds]
    settings = {"batch": batch, "steps": steps, "repeats": repeats}
    return {**settings, **common.spread("env_steps_per_second", rates)}


def main() -> None:
    kinds = {"gymnasium": gymnasium_rows, "spring": spring_rows}
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kind", choices=kinds)
    parser.add_argument("robot", metavar="ROBOT")
    for size in ("batch", "steps", "repeats"):
        parser.add_argument(size, metavar=size.upper(), type=int)
    options = parser.parse_args()
    print(json.dumps(kinds[options.kind](options.robot, options.batch, options.steps, options.repeats)))


if __name__ == "__main__":
    sys.exit(exit_code("physics_others", main))
