"""Time and memory of training against the number of seeds and of tasks, each size in a process of its own.

Batch and environments are those of `fast` for every task, and the replay holds five epochs, so all that could grow with
the tasks does. Seconds are of the processor, which other programs of the machine change less than the wall's. `growth`
is the exponent between the two sizes of a pair: 1 is linear.
"""

from __future__ import annotations

import argparse
import json
import math
import resource
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

from benchmarks import common
from ear_jax.cli.exits import exit_code
from ear_jax.runs import records
from experiments.report import documents

DOCUMENT, PLACE = common.RESULTS.parent.parent / "docs" / "scale.md", "costs"
SIZES = {"seeds": ((1, 10), (2, 10), (4, 10), (8, 10)), "tasks": ((1, 10), (1, 100), (1, 1000))}
QUICK = {"seeds": ((1, 2), (2, 2)), "tasks": ((1, 2), (1, 4))}
UPDATES, QUICK_UPDATES = 50, 2  # of an epoch; its fixed costs are shared among them
EPOCHS_HELD = 5  # epochs of collection that the replay holds; those of `fast` are 100
WORDS = {
    "collect_seconds": "collection grows with them",
    "update_seconds": "an update",
    "evaluate_seconds": "evaluation",
    "state_bytes": "state",
    "peak_bytes": "peak memory",
}
COSTS = tuple(WORDS)
# The row of an update whose critics still multiplied by the one-hot.
ONE_HOT = {"axis": "tasks", "seeds": 1, "tasks": 1000, "commit": "e3a7111bb1b2"}


def measure(seeds: int, tasks: int, updates: int, repeats: int) -> dict[str, float]:
    """Returns the costs of a size in this process: of an epoch's collection, an update, an evaluation, and memory."""
    import jax

    from ear_jax.presets import preset_config
    from ear_jax.process.runtime import tree_bytes
    from ear_jax.runs import training
    from ear_jax.runs.compiled import compile_program

    config = preset_config("halfcheetah-vel", "fast")
    of_a_task = config.sac.batch_size // 10
    collect = config.collect
    config = replace(
        config,
        engine="native",
        seeds=seeds,
        tasks=tuple(f"{1 + 9 * index / max(1, tasks - 1):.4g}" for index in range(tasks)),
        sac=replace(config.sac, batch_size=of_a_task * tasks, updates=updates),
        replay=replace(config.replay, capacity=EPOCHS_HELD * collect.envs * collect.steps * tasks),
        log=replace(config.log, episodes=1),
    )
    keys = training.seed_keys(config)
    compiled = compile_program(training.make_program(config), keys)
    state = compiled.init(keys)
    bytes_of_state = tree_bytes(state)
    timed: dict[str, list[float]] = {name: [] for name in ("collect", "learn", "evaluate")}
    for _ in range(repeats + 1):
        began = time.process_time()
        state, _ = jax.block_until_ready(compiled.collect(state))
        collected = time.process_time()
        state, _ = jax.block_until_ready(compiled.learn(state))
        learnt = time.process_time()
        timed["collect"].append(collected - began)
        timed["learn"].append(learnt - collected)
    for number in range(2):
        began = time.process_time()
        jax.block_until_ready(compiled.evaluate(state.learner.policy, training.evaluation_keys(keys, number)))
        timed["evaluate"].append(time.process_time() - began)
    least = {name: min(values[1:]) for name, values in timed.items()}
    return {
        "collect_seconds": least["collect"],
        "update_seconds": least["learn"] / updates,
        "evaluate_seconds": least["evaluate"],
        "state_bytes": bytes_of_state,
        "peak_bytes": 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss,
    }


def apart(seeds: int, tasks: int, updates: int, repeats: int) -> dict[str, float]:
    """Returns what `measure` returns, from a process of its own."""
    code = "import json, sys; from benchmarks.scale import measure; print(json.dumps(measure(*map(int, sys.argv[1:]))))"
    words = [sys.executable, "-c", code, *map(str, (seeds, tasks, updates, repeats))]
    done = subprocess.run(words, stdout=subprocess.PIPE, text=True, check=True)
    return json.loads(done.stdout.splitlines()[-1])


def growth(before: dict[str, float], after: dict[str, float], factor: float) -> dict[str, float]:
    """Returns by cost the exponent p with which it grew, as factor^p."""
    return {name: round(math.log(after[name] / before[name]) / math.log(factor), 3) for name in COSTS}


def against(options: argparse.Namespace, axis: str, sizes: tuple[tuple[int, int], ...]) -> None:
    """Measures sizes along an axis and writes a row for each, with the growth from the one before."""
    updates, repeats = (QUICK_UPDATES, 1) if options.quick else (UPDATES, 3)
    costs: list[dict[str, float]] = []
    for index, (seeds, tasks) in enumerate(sizes):
        costs.append(apart(seeds, tasks, updates, repeats))
        row: dict[str, Any] = {"axis": axis, "seeds": seeds, "tasks": tasks, "updates": updates, "repeats": repeats}
        row |= {name: float(f"{value:.5g}") for name, value in costs[-1].items()}
        if index:
            factor = math.prod(sizes[index]) / math.prod(sizes[index - 1])
            row["growth"] = growth(costs[-2], costs[-1], factor)
        common.write_row(options, "scale", row)


def measured(benchmark: str, results: Path) -> list[dict[str, Any]]:
    """Returns the rows of whole measurements, the newest last."""
    return [row for row in records.read_rows(results / f"{benchmark}.jsonl") if not row["quick"]]


def newest(benchmark: str, results: Path) -> list[dict[str, Any]]:
    """Returns the last whole measurement of each size, or of each other row's kind."""
    rows = measured(benchmark, results)
    return list({(row.get("axis"), row.get("seeds"), row.get("tasks")): row for row in rows}.values())


def total_growth(rows: list[dict[str, Any]]) -> dict[str, float]:
    """Returns by cost the exponent over a whole axis."""
    sizes = [row["seeds"] * row["tasks"] for row in rows]
    return growth(rows[0], rows[-1], sizes[-1] / sizes[0])


def costs(results: Path = common.RESULTS) -> str:
    """Returns the measured part of docs/scale.md."""
    found = sorted(newest("scale", results), key=lambda row: (row["axis"], row["seeds"], row["tasks"]))
    lines = [
        "| seeds | tasks | collection of an epoch | an update | an update, per seed and task | an evaluation | state | "
        "peak memory |",
        "|" + "---|" * 8,
    ]
    seen = set()
    for row in found:
        if (size := (row["seeds"], row["tasks"])) not in seen:
            seen.add(size)
            lines.append(
                f"| {row['seeds']} | {row['tasks']:,} | {row['collect_seconds']:.2f} s | "
                f"{1e3 * row['update_seconds']:,.0f} ms | {1e3 * row['update_seconds'] / math.prod(size):.1f} ms | "
                f"{row['evaluate_seconds']:.2f} s | "
                f"{row['state_bytes'] / 1e6:,.0f} MB | {row['peak_bytes'] / 1e9:.1f} GB |"
            )
    told = [*(_along(axis, [row for row in found if row["axis"] == axis]) for axis in SIZES), *_one_hot(results)]
    (saving,), (cluster,) = newest("saving", results), newest("cluster", results)
    return "\n".join((*lines, "", " ".join(told), "", plan(found, saving), "", _ray(cluster)))


def _along(axis: str, rows: list[dict[str, Any]]) -> str:
    """Returns the growth of all costs along an axis, in words."""
    powers = ", ".join(f"{WORDS[name]} to the power {power:.2f}" for name, power in total_growth(rows).items())
    return f"From {rows[0][axis]} to {rows[-1][axis]:,} {axis}: {powers}."


def _one_hot(results: Path) -> list[str]:
    """Returns the time of an update that multiplied by the one-hot, in words; nothing without its row."""
    return [
        f"While critics multiplied by the one-hot, an update of {row['tasks']:,} tasks took "
        f"{1e3 * row['update_seconds']:,.0f} ms."
        for row in measured("scale", results)
        if ONE_HOT.items() <= row.items()
    ]


def plan(rows: list[dict[str, Any]], saving: dict[str, Any]) -> str:
    """Returns what 1,000 seeds and 1,000 tasks would cost, in words."""
    from ear_jax.presets import preset_config

    config = preset_config("halfcheetah-vel", "fast")
    hours = saving["seconds_between"] / saving["epochs_between"] * config.epochs / 3600
    largest = max(rows, key=lambda row: row["tasks"])
    factor = 1000 / largest["tasks"]  # linear beyond what was measured
    epoch = factor * (largest["collect_seconds"] + config.sac.updates * largest["update_seconds"])
    held = config.replay.capacity / (10 * config.collect.envs * config.collect.steps) / EPOCHS_HELD
    return (
        f"**On paper, 1,000 seeds** of HalfCheetah-Vel under `fast` take {1000 * hours:,.0f} core-hours on a CPU "
        f"without evaluations, and {1000 * saving['megabytes'] / 1e3:.0f} GB of state, over all hosts and in each "
        "checkpoint. Hosts hardly talk, so the first limit is the checkpoint: process 0 alone computes its checksums "
        "while the others wait, and the file system is shared. `--checkpoint.blocks` spaces checkpoints out. "
        f"**On paper, 1,000 tasks** need {factor * held * largest['state_bytes'] / 1e9:.0f} GB for a replay as long "
        f"as that of `fast`, and an epoch takes {epoch / 3600:.1f} core-hours, nearly all of it updates, because the "
        "batch grows with the tasks. So the update is the first limit: keep the batch, which then has few transitions "
        "of each task, or use a GPU."
    )


def _ray(row: dict[str, Any]) -> str:
    """Returns the overhead of Ray, in words."""
    more, least, most = (100 * (row[name] - 1) for name in ("ratio", "ratio_min", "ratio_max"))
    return (
        f"Six runs of {row['seconds_a_run']:.0f} s, two at a time, took {row['by_hand_seconds']:.0f} s by hand and "
        f"{row['on_ray_seconds']:.0f} s on a Ray cluster of two nodes: {more:.1f} % more, the median of "
        f"{row['repeats']} repeats ({least:.1f} to {most:.1f} %)."
    )


def main() -> None:
    options = common.arguments(__doc__)
    for axis, sizes in (QUICK if options.quick else SIZES).items():
        against(options, axis, sizes)
    if not options.quick and options.results.samefile(common.RESULTS):
        documents.put(DOCUMENT, PLACE, costs(options.results))


if __name__ == "__main__":
    sys.exit(exit_code("scale", main))
