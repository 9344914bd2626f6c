"""Other libraries compared with ours: the update in plain PyTorch, and SBX's SAC on a Gymnasium task.

They run in a virtual environment of their own, created from `peers.txt` at the first call. They are not imported here:
each measurement of a peer comes from a process that runs nothing else. Ours and theirs are timed in turn.
"""

from __future__ import annotations

import argparse
import dataclasses
import importlib.util
import json
import subprocess
import sys
import time
import venv
from functools import partial
from pathlib import Path
from typing import Any

import jax

from benchmarks import common
from benchmarks.chunk import epoch_run
from benchmarks.matmul import with_matmul
from benchmarks.update import filled, update_run
from ear_jax.cli.exits import exit_code
from ear_jax.config import Config
from ear_jax.presets import preset_config
from ear_jax.runs import training

HERE = Path(__file__).resolve().parent
PLACE = HERE / ".peers"
FAMILY = "halfcheetah-vel"


def interpreter() -> str:
    """Returns the Python of the peers' virtual environment, which is created if missing."""
    python = PLACE / "bin" / "python"
    if not (PLACE / "made").exists():
        print(f"installing peers into {PLACE}", file=sys.stderr)
        venv.create(PLACE, clear=True, with_pip=True)
        subprocess.run([python, "-m", "pip", "install", "--quiet", "-r", HERE / "peers.txt"], check=True)
        (PLACE / "made").touch()
    return str(python)


def ask(script: str, settings: dict[str, Any], python: str | None = None) -> dict[str, Any]:
    """Runs a peer's script, by default with the Python of their environment, and returns the JSON that it prints."""
    command = [python or interpreter(), HERE / script, json.dumps(settings)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return json.loads(done.stdout.splitlines()[-1])


def python_with_torch() -> str | None:
    """Returns a Python that has PyTorch already: this one, or that of the peers' environment; None without either."""
    if importlib.util.find_spec("torch"):
        return sys.executable
    return interpreter() if (PLACE / "made").exists() else None


def torch_settings(config: Config, program: training.Program, updates: int) -> dict[str, Any]:
    sizes = {
        "obs": program.family.observation_size,
        "act": program.family.action_size,
        "tasks": len(program.tasks),
        "updates": updates,
    }
    return {**dataclasses.asdict(config.network), **dataclasses.asdict(config.sac), **sizes}


def measure_update(options: argparse.Namespace, preset: str, updates: int, repeats: int) -> None:
    """Times our update and PyTorch's, each with float32 and with bf16 matmuls."""
    config = preset_config(FAMILY, preset)
    program = training.make_program(config)
    state = jax.jit(jax.vmap(partial(filled, program)))(training.seed_keys(config))
    rounded = training.make_program(with_matmul(config, "bfloat16"))
    ours = {"ours_ms": update_run(program, state, updates), "ours_bf16_ms": update_run(rounded, state, updates)}
    for update in ours.values():
        update()  # compiles
    settings = torch_settings(config, program, updates)
    figures: dict[str, list[float]] = {name: [] for name in (*ours, "torch_ms", "torch_bf16_ms")}
    version = ""
    for _ in range(repeats):
        for name, update in ours.items():
            began = time.perf_counter()
            update()
            figures[name].append(1e3 * (time.perf_counter() - began) / updates)
        for name, bf16 in (("torch_ms", False), ("torch_bf16_ms", True)):
            answer = ask("peer_torch.py", {**settings, "bf16": bf16})
            figures[name].append(answer["ms"])
            version = answer["version"]
    row: dict[str, Any] = {"what": "update", "preset": preset, "peer": f"torch {version}", "repeats": repeats}
    for name, values in figures.items():
        row.update(common.spread(name, values))
    row.update(common.spread("ratio_to_torch", common.ratios(figures["ours_ms"], figures["torch_ms"])))
    common.write_row(options, "peers", row)


def sac_config(envs: int, updates: int) -> Config:
    """Returns a configuration with one task and SBX's defaults: two layers of 256 without LayerNorm, batches of 256."""
    base = preset_config(FAMILY, "fast")
    return dataclasses.replace(
        base,
        tasks=("1",),
        network=dataclasses.replace(base.network, critic_layer_norm=False, standardise_obs=False),
        sac=dataclasses.replace(base.sac, batch_size=256, updates=updates),
        collect=dataclasses.replace(base.collect, envs=envs, steps=updates // envs),
    )


def measure_sac(options: argparse.Namespace, steps: int, repeats: int) -> None:
    """Times SAC with one update for each env step, collection and updates together."""
    envs = 8
    config = sac_config(envs, steps)
    program = training.make_program(config)
    state = jax.jit(jax.vmap(partial(filled, program)))(training.seed_keys(config))
    epoch = epoch_run(program, state)
    epoch()
    network = config.network
    settings = {
        "envs": envs,
        "width": network.width,
        "layers": network.critic_layers,
        "batch_size": 256,
        "steps": steps,
    }
    ours, theirs, version = [], [], ""
    for _ in range(repeats):
        began = time.perf_counter()
        epoch()
        ours.append(steps / (time.perf_counter() - began))
        answer = ask("peer_sbx.py", settings)
        theirs.append(answer["steps_per_second"])
        version = answer["version"]
    row = {
        "what": "sac",
        "peer": f"sbx {version}",
        **settings,
        "repeats": repeats,
        **common.spread("ours_steps_per_second", ours),
        **common.spread("sbx_steps_per_second", theirs),
        **common.spread("times_faster", common.ratios(ours, theirs)),
    }
    common.write_row(options, "peers", row)


def main() -> None:
    options = common.arguments(__doc__)
    for preset in ("fast", "paper"):
        measure_update(options, preset, *((2, 1) if options.quick else (40, 5)))
    measure_sac(options, *((400, 1) if options.quick else (4000, 5)))


if __name__ == "__main__":
    sys.exit(exit_code("peers", main))
