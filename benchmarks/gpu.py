"""All measurements on a GPU, in eight minutes: updates, collection, epochs, a run, and a page of figures.

    make bench-gpu            # or: python -m benchmarks.gpu --minutes 8 --results FOLDER

Measurements come in the order of their worth, and those that no longer fit are skipped with a line; `--only torch run`
measures these in a second call. Each row tells the seconds of compiling. Set EAR_JAX_CACHE to a folder that you bring
back: with it the next call compiles nothing. PyTorch is measured where this Python or `benchmarks/.peers` has it.
`--trace FOLDER` keeps a profile of an epoch's updates. `--quick` rehearses one measurement of each kind on a CPU.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from subprocess import CalledProcessError
from typing import Any

import jax

from benchmarks import common, equal_bits, peers, time_to_return
from benchmarks.gpu_page import draw_page
from benchmarks.update import filled
from ear_jax.cli.exits import exit_code
from ear_jax.config import Config
from ear_jax.errors import RunError, UsageError
from ear_jax.presets import preset_config
from ear_jax.process.precision import product
from ear_jax.process.runtime import compiler_options, enable_cache
from ear_jax.runs import on_host, training
from ear_jax.runs.compiled import Compiled, fill_replay, train_epochs
from ear_jax.runs.loop import train_run
from ear_jax.runs.seeds import over_seeds

FAMILIES = ("halfcheetah-vel", "hopper-vel", "walker-vel")
REPEATS = 5
# What a measurement needs at most, from a cold cache.
SECONDS = {"update": 45, "collect": 60, "epoch": 60, "torch": 45, "bits": 120, "run": 90}

RUN = 150  # seconds that the run may take, as far as they are left


def changed(config: Config, **settings: Any) -> Config:
    """Returns a configuration with settings changed, named as in `sac__updates`."""
    for name, value in settings.items():
        group, _, setting = name.rpartition("__")
        part = dataclasses.replace(getattr(config, group), **{setting: value}) if group else value
        config = dataclasses.replace(config, **{group or setting: part})
    return config


def small(config: Config) -> Config:
    """Returns a configuration for rehearsal."""
    small_sizes = {"network__width": 64, "sac__batch_size": 160, "sac__updates": 2, "collect__steps": 5}
    return changed(config, **small_sizes, replay__capacity=2000, collect__pretrain_epochs=1, epochs=4, log__epochs=2)


def timed(call: Callable[[Any], Any], state: Any, repeats: int) -> list[float]:
    """Returns the seconds of repeated calls, each given the last one's state; the first call is not timed."""
    state, seconds = jax.block_until_ready(call(state)[0]), []
    for _ in range(repeats):
        began = time.perf_counter()
        state = jax.block_until_ready(call(state)[0])
        seconds.append(time.perf_counter() - began)
    return seconds


def filling(program: training.Program) -> Callable[[jax.Array], Any]:
    """Returns a function of the seeds' keys that makes states with full replays."""
    return jax.jit(jax.vmap(partial(filled, program)), compiler_options=compiler_options())


def measure_update(options: argparse.Namespace, config: Config) -> dict[str, Any]:
    """Times an epoch's updates of all seeds."""
    program, keys = training.make_program(config), training.seed_keys(config)
    state = filling(program)(keys)
    learn = over_seeds(partial(training.learn, program), config.seeds, config.network.matmul, donate_argnums=0)
    began = time.perf_counter()
    learn = learn.lower(state).compile()
    compile_seconds = time.perf_counter() - began
    seconds = timed(learn, state, REPEATS)
    if options.trace:
        state = filling(program)(keys)
        with jax.profiler.trace(str(options.trace / f"{config.seeds}-seeds")):
            jax.block_until_ready(learn(state))
    sizes = {"batch_size": config.sac.batch_size, "kernels": "xla"}
    updates = [1e3 * value / config.sac.updates for value in seconds]
    return {**sizes, "compile_s": round(compile_seconds, 1), **common.spread("update_ms", updates)}


def ready(config: Config) -> tuple[Compiled, Any, float]:
    """Returns a run's compiled programs, its state with some experience, and the seconds of compiling."""
    program, keys = training.make_program(config), training.seed_keys(config)
    began = time.perf_counter()
    compiled = on_host.compiler_of(program)(program, keys)
    seconds = time.perf_counter() - began
    return compiled, fill_replay(compiled, compiled.init(keys), 1), seconds


def measure_collect(options: argparse.Namespace, config: Config) -> dict[str, Any]:
    """Times an epoch of collection."""
    compiled, state, compile_seconds = ready(config)
    seconds = timed(compiled.collect, state, REPEATS)
    return {"engine": config.engine, "compile_s": round(compile_seconds, 1), **common.spread("collect_s", seconds)}


def measure_epoch(options: argparse.Namespace, config: Config) -> dict[str, Any]:
    """Times epochs of collection and updates."""
    compiled, state, compile_seconds = ready(config)
    seconds = timed(lambda state: train_epochs(compiled, state, 1), state, REPEATS)
    about = {"engine": config.engine, "overlap": config.collect.overlap}
    return {**about, "compile_s": round(compile_seconds, 1), **common.spread("epoch_s", seconds)}


def measure_torch(options: argparse.Namespace, config: Config) -> dict[str, Any]:
    """Times the same update of one seed in compiled PyTorch."""
    python = peers.python_with_torch()
    if python is None:
        return {"failed": "no PyTorch here: `python -m benchmarks.peers --quick` installs it beside this environment"}
    settings = peers.torch_settings(config, training.make_program(config), config.sac.updates)
    device = "cpu" if options.quick else "cuda"
    settings |= {"bf16": False, "device": device, "compile": not options.quick, "repeats": REPEATS}
    answer = peers.ask("peer_torch.py", settings, python)
    figures = common.spread("update_ms", answer["each_ms"])
    about = {"what": "update", "batch_size": config.sac.batch_size, "kernels": f"torch {answer['version']}"}
    return {**about, **figures}


def measure_bits(flags: str, options: argparse.Namespace, config: Config) -> dict[str, Any]:
    """Tells whether fresh processes end a short run with equal bits, under XLA's flags."""
    equal = equal_bits.compare("smoke" if options.quick else config.preset, flags)
    return {"engine": config.engine, "epochs": equal_bits.EPOCHS, "xla_flags": flags, **equal}


def measure_run(options: argparse.Namespace, config: Config) -> dict[str, Any]:
    """Trains a new run and returns the seconds to its marks and to its end, from the start of the process' work."""
    with tempfile.TemporaryDirectory() as scratch:
        directory = Path(scratch) / "run"
        began = time.perf_counter()
        train_run(config, directory)
        seconds = time.perf_counter() - began
        marks = to_marks(time_to_return.rows_of(directory))
    return {"engine": config.engine, "epochs": config.epochs, "run_s": round(seconds, 1), **marks}


def to_marks(rows: list[dict[str, Any]]) -> dict[str, float]:
    """Returns by mark how many seeds passed it, and the median seconds over all seeds where more than half did.

    Args:
      rows: one for each seed and mark, without `seconds` where the seed never passed the mark.
    """
    found: dict[str, float] = {}
    for mark in dict.fromkeys(row["return"] for row in rows):
        seconds = [row.get("seconds", math.inf) for row in rows if row["return"] == mark]
        found[f"to_{mark:g}_passed"] = sum(map(math.isfinite, seconds))
        if math.isfinite(median := statistics.median(seconds)):
            found[f"to_{mark:g}_s"] = median
    return found


Measurement = tuple[str, Callable[[argparse.Namespace, Config], dict[str, Any]], Config]


def measurements(options: argparse.Namespace) -> Iterator[Measurement]:
    """Yields what is measured, the most telling first."""
    fast = partial(preset_config, preset="fast")
    engines = ("native",) if options.quick else ("native", "mjx", "mjx-fixed")
    cheetah = changed(fast("halfcheetah-vel"), seeds=5)
    yield "update", measure_update, cheetah
    for overlap in (False, True):
        yield "epoch", measure_epoch, changed(cheetah, engine="native", collect__overlap=overlap)
    for engine in engines:
        yield "collect", measure_collect, changed(cheetah, engine=engine)
    for batch in (480, 1920):
        alone = changed(cheetah, seeds=1, sac__batch_size=batch)
        yield "update", measure_update, alone
        yield "torch", measure_torch, alone
    yield "bits", partial(measure_bits, ""), changed(cheetah, seeds=1, engine="native")
    yield "run", measure_run, changed(cheetah, engine="native", collect__overlap=True)
    yield "update", measure_update, changed(cheetah, sac__batch_size=1920)
    yield "update", measure_update, changed(cheetah, seeds=16)
    yield "bits", partial(measure_bits, equal_bits.NO_AUTOTUNING), changed(cheetah, seeds=1, engine="native")
    yield "update", measure_update, changed(cheetah, network__matmul="bfloat16")
    for family in FAMILIES[1:]:
        for engine in engines:
            yield "collect", measure_collect, changed(fast(family), seeds=3, engine=engine)
        yield "epoch", measure_epoch, changed(fast(family), seeds=3, engine="native", collect__overlap=True)


def chosen(options: argparse.Namespace) -> Iterator[Measurement]:
    """Yields the measurements that are asked for; of those of a kind a rehearsal has the first."""
    seen = set()
    for what, measure, config in measurements(options):
        kind = (what, config.collect.overlap)
        if what in options.only and not (options.quick and kind in seen):
            seen.add(kind)
            yield what, measure, config


def options_of() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="rehearse in small; the timings mean nothing")
    parser.add_argument("--minutes", type=float, default=8.0, help="time for everything, compiling included")
    parser.add_argument("--only", nargs="+", choices=SECONDS, default=SECONDS, help="what to measure (default: all)")
    parser.add_argument("--results", type=Path, default=common.RESULTS, help="directory of gpu.jsonl and gpu.png")
    parser.add_argument("--trace", type=Path, help="directory of profiles")
    return parser.parse_args()


def main() -> None:
    options, began = options_of(), time.perf_counter()
    enable_cache()
    if jax.default_backend() == "cpu" and not options.quick:
        print("bench-gpu skipped: JAX finds no GPU here (--quick rehearses it on the CPU)")
        return
    for what, measure, config in chosen(options):
        config = small(config) if options.quick else config
        left = 60 * options.minutes - (time.perf_counter() - began)
        about = {"what": what, "family": config.family, "seeds": config.seeds}
        if left < (30 if options.quick else SECONDS[what]):
            print(f"skipped for want of time: {about}", file=sys.stderr)
            continue
        if what == "run":
            config = changed(config, minutes=min(left - 15, RUN) / 60)
        try:
            row = measure(options, config)
        except (RunError, UsageError, jax.errors.JaxRuntimeError, CalledProcessError) as error:
            row = {"failed": str(error).splitlines()[0][:200]}
        device = {"device": jax.local_devices()[0].device_kind, "host_cores": os.cpu_count()}
        common.write_row(options, "gpu", {**about, **device, "precision": product(config.network.matmul), **row})
    draw_page(options.results)


if __name__ == "__main__":
    sys.exit(exit_code("gpu", main))
