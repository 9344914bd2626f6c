"""Wall time of `ear adapt`, `ear interpolate` and `ear map`, compared with a plain Python loop over candidates.

Commands are timed from start to exit, in fresh processes: start, compilation, roll-outs and figures. They play an agent
that ships with the package. The loop works as the original code does: one candidate after another, in one environment,
with one policy call for each step.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from benchmarks import common
from ear_jax.agents.tanh_gaussian import squash
from ear_jax.cli.exits import exit_code
from ear_jax.embeddings.codes import fibonacci_sphere
from ear_jax.embeddings.interpolate import FRESH
from ear_jax.physics import Physics
from ear_jax.runs.trained import Trained, load, policy_of

RUN = "pretrained:halfcheetah-vel"
COMMANDS = {  # arguments after the run, and the number of episodes of each LTE
    "map": (("--places", "2000"), 1),
    "interpolate": (("--all-pairs",), 3),
    "adapt": ((), 5),
}
QUICK = {"map": (), "interpolate": (), "adapt": ("--epochs", "1")}  # and one episode of each LTE


def time_command(words: tuple[str, ...], directory: str) -> tuple[float, dict[str, Any]]:
    """Returns the seconds of an `ear` command that writes to a working directory, and the document that it prints."""
    began = time.perf_counter()
    root = Path(__file__).resolve().parents[1]
    environment = {**os.environ, "PYTHONPATH": str(root)}
    command = [sys.executable, "-m", "ear_jax.cli.main", *words]
    done = subprocess.run(command, check=True, capture_output=True, cwd=directory, env=environment)
    return time.perf_counter() - began, json.loads(done.stdout)


def env_steps(command: str, document: dict[str, Any], episodes: int, steps: int) -> int:
    """Returns the env steps that a command took, those of evaluations included.

    Args:
      command: its name.
      document: the JSON that it printed.
      episodes: `--episodes`: on a map, of each blend, or of each evaluation.
      steps: the length of an episode.
    """
    if command == "map":
        return steps * episodes * sum(len(entry["ltes"]) for entry in document["seeds"])
    if command == "interpolate":
        return steps * len(document["pairs"]) * (episodes * len(document["betas"]) + FRESH)
    evaluated = sum(len(task["epochs"]) + (task["target"] is not None) for task in document["tasks"])
    return document["env_steps"] + document["map_env_steps"] + steps * episodes * evaluated


def loop_steps_per_second(trained: Trained, candidates: int) -> float:
    """Returns env steps per second of candidates played one after another with MuJoCo's `mj_step`."""
    family, agent = trained.program.family, trained.program.agent
    policy = policy_of(trained, 0)
    no_noise = jnp.zeros(family.action_size)

    @jax.jit
    def act(code: jax.Array, qpos: np.ndarray, qvel: np.ndarray) -> jax.Array:
        obs = family.observe(Physics(jnp.asarray(qpos), jnp.asarray(qvel), jnp.zeros_like(qvel)))
        return squash(agent.distribution(policy, code, obs), no_noise)

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


def measure(options: argparse.Namespace, command: str, trained: Trained, directory: str) -> None:
    """Times a command, with the loop before each of its runs so that their ratio is robust to drift of the machine."""
    words, episodes = COMMANDS[command]
    repeats = 3
    if options.quick:
        words, episodes, repeats = (*words, *QUICK[command]), 1, 1
    words = (command, RUN, *words, "--episodes", str(episodes), "--json")
    steps, seconds, loops = 0, [], []
    for _ in range(repeats):
        loops.append(loop_steps_per_second(trained, 2 if options.quick else 20))
        took, document = time_command(words, directory)
        seconds.append(took)
        steps = env_steps(command, document, episodes, trained.program.family.episode_length)
    speedups = [steps / rate / elapsed for rate, elapsed in zip(loops, seconds, strict=True)]
    row = {
        "command": command,
        "env_steps": steps,
        "repeats": repeats,
        **common.spread("seconds", seconds),
        **common.spread("loop_env_steps_per_second", loops),
        **common.spread("times_faster_than_loop", speedups),
    }
    common.write_row(options, "adaptation", row)


def main() -> None:
    options = common.arguments(__doc__)
    trained = load(Path(RUN))
    with tempfile.TemporaryDirectory() as directory:
        for command in COMMANDS:
            measure(options, command, trained, directory)


if __name__ == "__main__":
    sys.exit(exit_code("adaptation", main))
