"""Kernels, memory traffic and CUDA graphs of programs compiled for an H100, on a machine without one.

XLA compiles for a described device, so these counts are the same on every machine; times are not known this way, and
XLA does not try out kernels (autotuning). Needs the dependency group `census`: `pip install --group census`, best in an
environment of its own, as CUDA's libraries take 5 GB. One row a program: `learn` an update, `collect` and `evaluate`
a step.
"""

from __future__ import annotations

import argparse
import dataclasses
import importlib.util
import os
import re
import sys
import tempfile
from collections import Counter
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks import common, hlo
from ear_jax.cli.exits import exit_code

DEVICE = Path(__file__).with_name("h100.txtpb")
PLUGIN = "jax_plugins.xla_cuda12"
# What a kernel of an update or a step is part of: the first pattern that its source matches. Sources are JAX's names
# of operations.
PARTS: dict[str, tuple[tuple[str, str], ...]] = {
    "learn": (
        ("critics backward", r"transpose\(jvp\(vmap\(vmap\(_(Mlp|Residual)"),
        ("critics forward", r"vmap\(vmap\(_(Mlp|Residual)"),
        ("policy backward", r"transpose\(jvp\(vmap\(_Mlp"),
        ("policy forward", r"vmap\(_Mlp"),
        ("gradient norms", r"closed_call/(vmap\(\)/)?(sqrt|reduce_sum)$"),
        ("Adam and target", r"closed_call/(vmap\(\)/)?(add|sub)$|select_n$"),
        ("losses backward", r"transpose\(jvp"),
        ("losses forward", r"jvp|vmap"),
    ),
    "step": (
        ("factorisations and solves", r"cusolver|triangularSolve"),
        ("policy", r"_Mlp"),
        ("other physics", r"while.*while"),
    ),
}


def missing() -> str | None:
    """Returns why programs cannot be compiled for a GPU here; None if they can."""
    try:
        found = importlib.util.find_spec(PLUGIN)
    except ModuleNotFoundError:
        found = None
    return None if found else "the dependency group `census` is not installed (pip install --group census)"


def compile_for_h100(what: str, config: Any, dump: Path) -> str:
    """Compiles one program of a run for all its seeds and returns its scheduled HLO; thunks are written to `dump`."""
    import jax
    from jax.experimental import topologies

    from ear_jax.process.target import tracing_for
    from ear_jax.runs import training

    description = "\n".join(line for line in DEVICE.read_text().splitlines() if not line.startswith("#"))
    topology = topologies.get_topology_desc(platform="cuda", target_config=description, topology="1x1x1")
    device = jax.sharding.SingleDeviceSharding(topology.devices[0])
    with tracing_for("gpu"):
        program = training.make_program(config)
        functions = {"learn": training.learn, "collect": training.collect, "evaluate": _evaluate}
        keys = training.seed_keys(config)
        state = jax.eval_shape(jax.vmap(partial(training.init, program)), keys)
        shapes = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype, sharding=device), state)
        donated = () if what == "evaluate" else 0
        traced = jax.jit(jax.vmap(partial(functions[what], program)), donate_argnums=donated).trace(shapes)
        lowered = traced.lower(lowering_platforms=("cuda",))
        return lowered.compile({"xla_dump_to": str(dump), "xla_gpu_cuda_data_dir": _compiler()}).as_text()


def _evaluate(program: Any, state: Any) -> Any:
    from ear_jax.runs import training

    return training.evaluate(program, state.learner.policy, state.key, program.config.log.episodes)


def _compiler() -> str:
    """Returns the folder of NVIDIA's assembler, from the group's packages."""
    spec = importlib.util.find_spec("nvidia.cuda_nvcc")
    assert spec is not None
    assert spec.submodule_search_locations
    return str(Path(next(iter(spec.submodule_search_locations))))


def count(text: str, what: str = "learn", rounds: int = 1) -> dict[str, Any]:
    """Counts the kernels of one iteration of a program's outermost loop with the most of them, its updates or steps.

    Args:
      text: the program's scheduled HLO.
      what: the program; only `learn` makes updates.
      rounds: how often a loop goes round whose number of iterations depends on data.

    Returns:
      `kernels`, `matmuls`, `traffic_mb`, `scatters` (which add in any order), `parts` (kernels by part), and
      `host_reads`: loops in an iteration whose end the host has to read from the device, each time round.
    """
    module = hlo.parse(text)
    outer = [loop.called("body") for loop in module.loops(module.entry)]
    bodies = {body: list(module.kernels(body, rounds=rounds)) for body in outer if body}
    body, kernels = max(bodies.items(), key=lambda item: len(item[1]))
    inner = [loop for loop in _loops_within(module, body) if loop.trips is None]
    return {
        "kernels": len(kernels),
        "matmuls": sum(kernel.is_matmul for kernel in kernels),
        "traffic_mb": round(sum(kernel.traffic for kernel in kernels) / 1e6, 1),
        "host_reads": len(inner) + sum(loop.trips is None for loop in module.loops(module.entry)),
        "scatters": sum("scatter" in kernel.ops for kernel in kernels),
        "parts": dict(Counter(part(kernel, what) for kernel in kernels).most_common()),
    }


def _loops_within(module: hlo.Module, computation: str) -> list[hlo.Instruction]:
    loops = module.loops(computation)
    return loops + [inner for loop in loops if (body := loop.called("body")) for inner in _loops_within(module, body)]


def part(kernel: hlo.Kernel, what: str = "learn") -> str:
    """Names the part of an update or a step that a kernel belongs to."""
    if what == "learn":
        for name, op in (("metrics", "dynamic-update-slice"), ("gathered batch", "gather")):
            if op in kernel.ops:
                return name
    patterns = PARTS.get(what, PARTS["step"])
    return next((name for name, pattern in patterns if re.search(pattern, kernel.source)), "other")


def graphs(dump: Path) -> dict[str, int]:
    """Counts the CUDA graphs in the dumped program's longest loop, and its thunks outside of them.

    Those of inner loops count once, however often they go round.
    """
    (listing,) = dump.glob("*thunk_sequence_after_thunk_passes.txt")
    return graphs_of(listing.read_text())


def graphs_of(listing: str) -> dict[str, int]:
    """Counts as `graphs` does, in the text of a listing."""
    listing = re.sub(r"^condition:\n.*?(?=^ *body:\n)", "", listing, flags=re.MULTILINE | re.DOTALL)
    outer = re.split(r"^  body:\n", listing, flags=re.MULTILINE)[1:]
    body = max((re.split(r"^ {0,2}\S", text, maxsplit=1, flags=re.MULTILINE)[0] for text in outer), key=len)
    above: list[tuple[int, str]] = []
    found: Counter[str] = Counter()
    for spaces, kind in re.findall(r"^( *)\d+: (k\w+)", body, re.MULTILINE):
        above = [outside for outside in above if outside[0] < len(spaces)]
        if all(name != "kCommandBuffer" for _, name in above):
            found["graphs" if kind == "kCommandBuffer" else "loose"] += 1
        above.append((len(spaces), kind))
    return {"graphs": found["graphs"], "loose": found["loose"]}


def measure(options: argparse.Namespace, what: str, engine: str, seeds: int = 5) -> None:
    """Compiles one program of `fast` HalfCheetah-Vel and writes its row."""
    about = {"program": what, "family": "halfcheetah-vel", "preset": "fast", "engine": engine, "seeds": seeds}
    common.write_row(options, "census", {**about, **counted(about)})


def engine_of(row: dict[str, Any]) -> str:
    """Returns the engine of a row's program; older rows do not name it."""
    return str(row.get("engine", "native" if row["program"] == "learn" else "mjx"))


def counted(about: dict[str, Any]) -> dict[str, Any]:
    """Compiles the program that a row is about and returns what is counted in it."""
    from ear_jax.envs import find_family
    from ear_jax.presets import preset_config

    what, learns = about["program"], about["program"] == "learn"
    config = preset_config(about["family"], about["preset"])
    config = dataclasses.replace(config, seeds=about["seeds"], engine=engine_of(about))
    # The solver goes on until the last of the environments has converged: nearly always to its limit.
    rounds = {} if learns else {"rounds": find_family(about["family"]).mjx_solver[0]}
    with tempfile.TemporaryDirectory() as scratch:
        text = compile_for_h100(what, config, Path(scratch))
        found = {**count(text, what, **rounds), **graphs(Path(scratch))}
    return {"kernels_by": "xla", "device": "H100", **rounds, **found}


def main() -> None:
    options = common.arguments(__doc__)
    if reason := missing():
        print(f"census skipped: {reason}")
        return
    os.environ["JAX_PLATFORMS"] = "cpu"
    measure(options, "learn", "native", 1 if options.quick else 5)
    for what, engine in (("collect", "mjx"), ("evaluate", "mjx"), ("collect", "mjx-fixed")):
        if not options.quick:
            measure(options, what, engine)


if __name__ == "__main__":
    sys.exit(exit_code("census", main))
