"""Words of documents on runs and commands, each with the numbers that records hold today."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np

from benchmarks import common
from ear_jax.runs import records
from experiments.inventory import RECORDS
from experiments.report import measures
from experiments.report.formatting import count, number, spread
from experiments.report.run_index import Run, RunIndex

CHEETAH = RECORDS / "halfcheetah-vel-ear-fast-seed0"


def of_the_cheetah() -> list[str]:
    """Words of `docs/results.md` about the run whose figures it shows."""
    rows = records.read_rows(CHEETAH / "metrics.jsonl")

    def passed(level: float) -> int:
        return round(next(row["seconds"] for row in rows if row["mean_return"] >= level) / 60)

    evaluated = json.loads((CHEETAH / "evaluation.json").read_text())["mean_return"]
    last = rows[-1]["seconds"] / 60
    return [
        f"past −250 in {passed(-250)} minutes, past −200 in {passed(-200)}, {number(evaluated, 0)} in {last:.0f}",
        f"{last:.0f} minutes on one CPU core",
    ]


def of_the_long_run() -> list[str]:
    """The gain of twice the length for the cheetah, in the words of `docs/trials.md`."""
    usual, long = (
        [one["mean_return"] for one in json.loads((RECORDS / name / "evaluation.json").read_text())["seeds"]]
        for name in ("halfcheetah-vel-ear-fast-seeds0-4", "halfcheetah-vel-ear-fast-760-epochs-seeds0-4")
    )
    assert len(usual) == len(long) == 5
    return [
        f"five seeds return {number(sum(long) / 5)} on average, and {number(sum(usual) / 5)} otherwise",
        f"the best of them reaches {number(max(long))}",
    ]


def of_the_ant() -> list[str]:
    """Its returns, speeds in m/s and episodes that end early, in the words of `docs/fast.md`."""
    returns, speeds, early = ants(*(f"fast-seed{seed}" for seed in range(3)))
    wide, wide_speeds, wide_early = ants(*(f"fast+wide-seed{seed}" for seed in range(3)))
    (half_as_long,), *_ = ants("fast-width-512-seed1")
    turned, *_ = ants(*(f"fast+equivariant-seed{seed}" for seed in range(3)))
    (low, high), (wide_low, wide_high) = (sorted(values, key=int)[::2] for values in (returns, wide))
    return [
        f"ant: {wide_low} to {wide_high} instead of {low} to {high}",
        f"Its seeds return {returns[0]}, {returns[1]} and {returns[2]}",
        f"at {speeds}",
        f"{early} episodes end early",
        f"its seeds return {wide[0]}, {wide[1]} and {wide[2]}, at {wide_speeds}",
        f"and {wide_early} episodes end early",
        f"seed 1 returns {half_as_long}",
        f"{min(turned)} to {max(turned)} after half the updates",
        f"three seeds return {turned[0]}, {turned[1]} and {turned[2]}",
    ]


def of_the_wide() -> list[str]:
    """Words on the hopper and the walker, twice as wide and as in `fast`."""
    found = RunIndex("fast")
    (wide_hopper,), (wide_walker,) = (found.runs(family, variant="+wide") for family in ("hopper-vel", "walker-vel"))
    hoppers, walkers = (list(map(measures.mean_return, found.runs(one))) for one in ("hopper-vel", "walker-vel"))
    assert len(hoppers) == len(walkers) == 3
    wide = " and ".join(number(measures.mean_return(run)) for run in (wide_hopper, wide_walker))
    usual = " and ".join(number(float(np.mean(returns))) for returns in (hoppers, walkers))
    return [f"The first wide seeds of hopper and walker return {wide}, the three seeds of {usual} on average"]


def aside(run: Run, angle: int, evaluation: str = "evaluation") -> float:
    """Returns the degrees by which an ant runs aside, the mean over the tasks symmetric to one from 0 to 45°."""
    found = []
    for task in json.loads((run.directory / f"{evaluation}.json").read_text())["seeds"][0]["tasks"]:
        quarter = task["target"] % 90
        if min(quarter, 90 - quarter) == angle:
            off = (np.array(task["episodes"]["direction"]) - task["target"] + 180) % 360 - 180
            found.append(np.mean(off) * (1 if quarter <= 45 else -1))
    return float(np.mean(found))


def of_the_turned() -> list[str]:
    """Words on the equivariant ants, their blends, and the trials that would have mended them."""
    runs = RunIndex("fast").runs("ant-dir", variant="+equivariant")
    beside = [measures.gaps(run)[0] for run in runs]
    midway = [met.number for run in runs if (met := measures.successes([run], "mid_task"))]
    axes, next_to_it = ([angle + aside(run, angle) for run in runs] for angle in (0, 15))
    trials = {row["trial"].removeprefix("… equivariant, "): dict(_returns(row)) for row in _trials("ant-dir")}
    penalised = [trials[f"lateral speed costs {one}"][20_000] for one in ("1, seed 2", "½, seed 0")]
    without = [trials[one][20_000] for one in ("noise stays in the sector, seed 2", "half as long, seed 0")]
    directions = max(_returns(_trial("ant-dir", "… equivariant, LTEs start at their directions, seed 0")))[1]
    return [
        "seeds 0, 1 and 2 run {:.0f}, {:.0f} and {:.0f}° aside".format(*axes),
        f"that of 15° at {min(next_to_it):.0f} to {max(next_to_it):.0f}°",
        "{}, {} and {} of the seeds' 24 pairs meet the direction midway".format(*midway),
        f"seed 2 returns {number(penalised[0], 0)}, penalty included, and {number(without[0], 0)} if trained without",
        f"seed 0 returns {number(penalised[1], 0)}, and {number(without[1], 0)} if trained without",
        f"those of 0 and 15° are {min(beside):.0f} to {max(beside):.0f}° from each other",
        f"it returned {number(directions, 0)}",
    ]


def _trials(family: str) -> list[dict[str, Any]]:
    return [row for row in records.read_rows(common.RESULTS / "recipe.jsonl") if row["family"] == family]


def _trial(family: str, name: str) -> dict[str, Any]:
    return next(row for row in _trials(family) if row["trial"] == name)


def _returns(row: dict[str, Any]) -> list[tuple[int, float]]:
    """Returns a trial's updates and returns."""
    return [(point[0], point[3]) for point in row["curve"]]


def ants(*names: str) -> tuple[list[str], str, str]:
    """Returns of recorded runs of the ant: each run's return, the range of speeds and the share of early ends."""
    returns, speeds, lengths = [], [], []
    for name in names:
        found = json.loads((RECORDS / f"ant-dir-ear-{name}" / "evaluation.json").read_text())
        returns.append(number(found["mean_return"], 0))
        for task in found["seeds"][0]["tasks"]:
            speeds.append(math.hypot(task["outcome"]["velocity_x"], task["outcome"]["velocity_y"]))
            lengths += task["episodes"]["length"]
    early = sum(length < 200 for length in lengths)
    return returns, f"{min(speeds):.1f} to {max(speeds):.1f} m/s", f"{early} of {count(len(lengths))}"


def of_refining() -> list[str]:
    """The returns of the refined cheetahs."""
    *most, last = (number(one["after"]) for one in measures.refinements(RunIndex("fast").runs("halfcheetah-vel")))
    return [f"the seeds return {', '.join(most)} and {last}"]


def of_refined_heads() -> list[str]:
    """MHMT-SAC before and after it was refined, beside the paper."""
    found = measures.refinements(RunIndex("fast").runs("halfcheetah-vel", "multihead"))
    before, after = (spread([entry[when] for entry in found]) for when in ("before", "after"))
    paper = measures.paper_return("halfcheetah-vel", "multihead")["mean"]
    hoppers = measures.refinements(RunIndex("fast").runs("hopper-vel", "multihead"))
    trained, refined = (spread([entry[when] for entry in hoppers]) for when in ("before", "after"))
    best, best_ant = (measures.paper_return(family, "multihead")["mean"] for family in ("hopper-vel", "ant-dir"))
    (apart,), together = (
        measures.refinements(RunIndex("fast").runs("ant-dir", "multihead", variant)) for variant in ("", "+equivariant")
    )
    short, enough = (spread([entry[when] for entry in together]) for when in ("before", "after"))
    return [
        f"from {trained} to {refined}; the paper's returns {number(best)}",
        f"On Ant-Dir the paper's MHMT-SAC returns {number(best_ant)}",
        f"returns {number(apart['before'])} as trained and {number(apart['after'])} after 800",
        f"Seeds 0 and 1 then return {short} as trained, after half the updates, and {enough} after",
        f"its three seeds return {before} as trained and {after} after",
        f"the paper's MHMT-SAC returns {number(paper)}",
    ]


def refined_ants() -> list[dict[str, Any]]:
    return measures.refinements(RunIndex("fast").runs("ant-dir", variant="+equivariant"))


def of_the_refined_ant() -> list[str]:
    """The returns of the equivariant ants before and after."""
    before, after = ([number(entry[when], 0) for entry in refined_ants()] for when in ("before", "after"))
    return ["its seeds return {}, {} and {}, and {}, {} and {} before".format(*after, *before)]


def of_the_penalty() -> list[str]:
    """The equivariant ants before and after they were refined with a penalty on lateral speed, in a table's rows."""
    runs, means = RunIndex("fast").runs("ant-dir", variant="+equivariant"), []
    asides = [[aside(run, 0, f"{when}evaluation") for run in runs] for when in ("", "refined-")]
    counts = {
        what: [str(measures.successes(runs, what, f"{when}interpolation")) for when in ("", "refined-")]
        for what in ("mid_task", "fresh", "one_to_one")
    }
    for when in ("before", "after"):
        means.append(spread([entry[when] for entry in refined_ants()]))
    return [
        "aside of an axis | " + " | ".join("{:.0f}, {:.0f} and {:.0f}°".format(*each) for each in asides),
        "meet the direction midway | " + " | ".join(counts["mid_task"]),
        "in the mean of 10 fresh episodes | " + " | ".join(counts["fresh"]),
        "blends that lie between | " + " | ".join(counts["one_to_one"]),
        "return, without the penalty | " + " | ".join(means),
    ]


def of_gains() -> list[str]:
    """The gains of refining, in the words of `docs/fast.md`."""
    cheetahs, ants = (
        [entry["after"] - entry["before"] for entry in entries]
        for entries in (measures.refinements(RunIndex("fast").runs("halfcheetah-vel")), refined_ants())
    )
    told = f"{number(min(ants), 0)} to {number(max(ants), 0)}"
    return [f"the cheetah gains {number(float(np.mean(cheetahs)), 0)}, the equivariant ant {told}"]


def of_commands() -> list[str]:
    """Words of `docs/results.md` about how long commands take."""
    rows: dict[str, dict[str, Any]] = {
        row["command"]: row for row in records.read_rows(common.RESULTS / "adaptation.jsonl") if not row["quick"]
    }
    return [
        f"99 each, in {rows['interpolate']['seconds']:.0f} seconds",
        f"2,000 LTEs rolled out in {rows['map']['seconds']:.0f} seconds",
    ]


def of_half_runs() -> list[str]:
    """Words of `docs/trials.md` on half runs on a GPU; where a trial stopped short, its updates follow its return."""
    rows = records.read_rows(common.RESULTS / "recipe.jsonl")
    curves = {(row["family"], row["trial"]): row["curve"] for row in rows}
    base, critics = "half as long, two seeds", "… residual categorical critics (BRC), the "
    wide = "… width 512, batch 1,920, the policy from half, bfloat16"
    narrow = "… bfloat16, seed 1"

    def reached(trial: str, family: str = "halfcheetah-vel") -> str:
        return number(curves[family, trial][-1][3], 0)

    def alone(updates: int) -> str:
        """The return of five seeds of `fast` on the way of a whole run."""
        return number({point[0]: point[3] for point in curves["halfcheetah-vel", "fast, five seeds"]}[updates], 0)

    def took(trial: str) -> str:
        return f"{curves['halfcheetah-vel', trial][-1][2]} s"

    def at(updates: int) -> str:
        """The ant's return under `fast` itself."""
        return number({point[0]: point[3] for point in curves["ant-dir", base]}[updates], 0)

    def both(trial: str) -> str:
        return f"{reached(trial)} | {reached(trial, 'ant-dir')} at {count(curves['ant-dir', trial][-1][0])}"

    return [
        f"itself ends at {reached(base)} (cheetah)",
        f"{reached(critics + 'lesser')}, with the mean of the critics {reached(critics + 'mean')}",
        f"| {reached(critics + 'lesser', 'ant-dir')} at 22,800 (: {at(22_800)}) |",
        f"a quarter of it | {reached('… batch 1,920, the policy from a quarter')} |",
        f"weight decay 0.01 | {both('… weight decay')} (: {at(45_600)})",
        f"outcomes | {both('… predictive φ')}",
        f"both | {both('… weight decay, predictive φ')}",
        f"bfloat16 | | {reached(wide, 'ant-dir')} at 76,000 (width alone, one seed: {reached(narrow, 'ant-dir')})",
        f"far behind: {reached('… BatchNorm, bins, held noise (XQC, FlashSAC)', 'ant-dir')} at 30,400 (: {at(30_400)})",
        f"four such runs took {took(critics + 'lesser')} and eight of {took(base)}",
        f"at {alone(72_000)} after 72,000 updates and at {alone(80_000)} after 80,000",
        f"in a whole one ({reached('fast, five seeds')})",
    ]


def of_second_families() -> list[str]:
    """Rows of `docs/trials.md` on trials on a CPU: returns at the last updates that `fast` was evaluated at, too."""

    def row(family: str, name: str, beside: str) -> str:
        own, usual = (dict(_returns(_trial(family, one))) for one in (name, beside))
        updates = max(set(own) & set(usual))
        return f"{number(own[updates], 0)} after {count(updates)} (: {number(usual[updates], 0)})"

    critics, norm = "… residual categorical critics (BRC), seed", "… BatchNorm, bins, held noise (XQC, FlashSAC), seed"
    return [
        "| walker | " + " | ".join(row("walker-vel", f"{critics} {seed}", f"fast, seed {seed}") for seed in (0, 1)),
        "| cheetah | "
        + " | ".join(
            row("halfcheetah-vel", f"{norm} {seed}", beside)
            for seed, beside in enumerate(("replay of 200,000, lr falling: fast", "fast, seed 1"))
        ),
    ]


def of_a_gpu() -> list[str]:
    """Words of `docs/training.md` about updates on a GPU."""
    rows = [row for row in records.read_rows(common.RESULTS / "gpu.jsonl") if row["what"] == "update"]
    times = {(row["kernels"], row["seeds"], row["precision"]): row["update_ms"] for row in rows}

    def took(kernels: str, seeds: int, digits: int, precision: str = "TF32") -> str:
        return f"{number(times[kernels, seeds, precision], digits)} ms"

    rounded = took("fused", 5, 2, "bfloat16")
    return [
        f"takes {took('xla', 5, 2)} at 5 seeds and {took('xla', 16, 2)} at 16",
        f"took {took('fused', 5, 1)} at 5 seeds ({rounded} in bfloat16) and {took('fused', 16, 1)} at 16",
    ]


def of_rounding() -> list[str]:
    """Words of `docs/training.md` about bfloat16 on two processors."""
    rows = [row for row in records.read_rows(common.RESULTS / "matmul.jsonl") if not row["quick"]]
    plain, wide = ([row["times_faster"] for row in rows if row["width"] == width] for width in (256, 512))
    assert number(min(plain), 1) == number(max(plain), 1)
    told = f"{min(wide):.1f} to {max(wide):.1f} times"
    return [f"is {plain[0]:.1f} times as fast as in float32, one of networks twice as wide {told}"]
