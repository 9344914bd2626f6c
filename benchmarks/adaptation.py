"""Seconds that `ear adapt`, `ear interpolate` and `ear map` take, and a plain Python loop over candidates beside them.

The commands are timed whole, in fresh processes: start, compilation, roll-outs and figures. They play a policy of the
`fast` preset's size after one update: how long a roll-out takes does not depend on what the robot does. The loop does
what the original does: one candidate after another, one environment, a policy call a step.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from benchmarks import common
from ear_jax.codes import fibonacci_sphere
from ear_jax.physics import Physics
from ear_jax.policy import squash
from ear_jax.trained import Trained, load

FAMILY = "halfcheetah-vel"
ONE_UPDATE = ("--epochs", "1", "--log.epochs", "1", "--sac.updates", "1", "--collect.pretrain-epochs", "1")
COMMANDS = {  # what is timed: the words after the run, and the environment steps they take
    "map": (("--places", "2000"), 2000 * 200),
    "interpolate": (("--all-pairs",), 9 * 99 * 3 * 200),
    "adapt": ((), 3 * 10 * 90 * 200),  # and 3 targets
}
QUICK = {"adapt": ("--epochs", "1"), "interpolate": ("--episodes", "1"), "map": ()}


def ear(*words: str) -> None:
    subprocess.run([sys.executable, "-m", "ear_jax.cli.main", *words], check=True, capture_output=True)


def time_command(command: str, run: Path, words: tuple[str, ...]) -> float:
    began = time.perf_counter()
    ear(command, str(run), *words, "--json")
    return time.perf_counter() - began


def targets(run: Path) -> tuple[str, ...]:
    """Three speeds that the mapped codes of a run do reach, whatever it has learnt."""
    ear("map", str(run), "--places", "200")
    achieved = json.loads((run / "map.json").read_text())["seeds"][0]["achieved"]
    return tuple(f"{speed:.4f}" for speed in np.quantile(achieved, (0.25, 0.5, 0.75)))


def loop_steps_per_second(trained: Trained, candidates: int) -> float:
    """Environment steps a second of candidates one after another, stepped by MuJoCo's own `mj_step`."""
    family, agent = trained.program.family, trained.program.agent
    policy = jax.tree.map(lambda leaf: leaf[0], trained.policies)
    still = jnp.zeros(family.action_size)

    @jax.jit
    def act(code: jax.Array, qpos: np.ndarray, qvel: np.ndarray) -> jax.Array:
        obs = family.observe(Physics(jnp.asarray(qpos), jnp.asarray(qvel), jnp.zeros_like(qvel)))
        return squash(agent.distribution(policy, code, obs), still)

    data = mujoco.MjData(family.model)

    def play(code: np.ndarray) -> None:
        mujoco.mj_resetData(family.model, data)
        for _ in range(family.episode_length):
            data.ctrl[:] = act(code, data.qpos, data.qvel)
            mujoco.mj_step(family.model, data, family.substeps)

    codes = fibonacci_sphere(candidates + 1)
    play(codes[-1])  # compiles
    began = time.perf_counter()
    for code in codes[:-1]:
        play(code)
    return candidates * family.episode_length / (time.perf_counter() - began)


def measure(options: argparse.Namespace, run: Path) -> None:
    """Every command, and the loop before each of its runs, so that their ratio holds while the machine drifts."""
    trained, repeats = load(run), 1 if options.quick else 3
    adapt_to = ("--target", *targets(run))
    for command, (words, steps) in COMMANDS.items():
        words += adapt_to if command == "adapt" else ()
        words += QUICK[command] if options.quick else ()
        seconds, loops = [], []
        for _ in range(repeats):
            loops.append(loop_steps_per_second(trained, 2 if options.quick else 20))
            seconds.append(time_command(command, run, words))
        row = {
            "command": command,
            "env_steps": steps,
            "repeats": repeats,
            **common.spread("seconds", seconds),
            **common.spread("loop_env_steps_per_second", loops),
            **common.spread(
                "times_faster_than_loop", [steps / rate / s for rate, s in zip(loops, seconds, strict=True)]
            ),
        }
        common.write_row(options, "adaptation", row)


def main() -> None:
    options = common.arguments(__doc__)
    with tempfile.TemporaryDirectory() as scratch:
        run = Path(scratch) / "run"
        ear("train", FAMILY, *ONE_UPDATE, "--out", str(run))
        measure(options, run)


if __name__ == "__main__":
    main()
