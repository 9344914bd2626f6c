"""Words of documents on what LTEs do, each with the numbers that records hold today."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from benchmarks import common
from ear_jax.runs import records
from experiments.inventory import RECORDS
from experiments.paper import BACK_JUMPING, BOTH, EVALUATION, FRONT, RUN_JUMP
from experiments.report import measures
from experiments.report.composition import motions_along_beta, raised_blends, raised_ltes
from experiments.report.formatting import number
from experiments.report.run_index import RunIndex
from tests.embeddings.test_twenty_rewards import reaches


def of_the_ring() -> list[str]:
    """The angles between embeddings of the ant's neighbouring directions, and their effect on blends."""
    found = RunIndex("fast")
    *even, broken = map(measures.gaps, found.runs("ant-dir", variant="+wide"))
    blends = json.loads((RECORDS / "ant-dir-ear-fast+wide-seed2" / "interpolation.json").read_text())["one_to_one"]
    assert [int(np.sum(measures.gaps(run) > 30)) for run in found.runs("ant-dir")] == [0, 5, 0]
    return [
        f"are {np.min(even):.0f} to {np.max(even):.0f}° apart in wide seeds 0 and 1",
        f"In seed 2 they are {min(broken):.0f} to {max(broken):.0f}° apart",
        f"lies between only {blends['success']} of its {blends['total']} neighbours",
    ]


def of_the_gathered() -> list[str]:
    """Words on the hopper's seed 0, with LTEs gathered at the start and without."""
    gathered, usual = (RunIndex("fast").runs("hopper-vel", variant=variant)[0] for variant in ("+gathered", ""))
    assert gathered.seed == usual.seed == 0
    gaps, pairs = [], []
    for run in (gathered, usual):
        gaps.append(f"{max(measures.gaps(run)):.0f}°")
        pairs.append([measures.successes([run], what) for what in ("mid_task", "one_to_one")])
    return [
        f"the widest gap is {gaps[0]} instead of {gaps[1]}",
        "the return {} instead of {}".format(*(number(measures.mean_return(run)) for run in (gathered, usual))),
        f"pairs, {pairs[0][0].number} meet the value midway instead of {pairs[1][0].number}",
        f"and {pairs[0][1].number} half-and-half blends lie between instead of {pairs[1][1].number}",
    ]


def of_running_and_jumping() -> list[str]:
    """Words on Run-Jump with tasks that reward both, in `docs/trials.md`."""
    traded, blends, evaluated = _trained_on_both()
    hops = next(task["outcome"] for task in evaluated["tasks"] if task["name"] == "both-2-5")
    ltes = np.array([task["lte"] for task in traded["trained"] if task["name"] in ("back-7", "jump-10", "both-2-5")])
    apart = np.degrees(np.arccos(np.clip(ltes @ ltes.T, -1, 1)))
    fastest, end = max(raised_blends(blends).both.values()), motions_along_beta(blends)[0]
    return [
        f"Of {len(traded['rewards']):,} LTEs {len(raised_ltes(traded).both)} run backward",
        f"at {number(-hops['velocity'], 1)} m/s with the hind foot at {number(hops['height'], 2)} m",
        f"Those two are {apart[0, 1]:.0f}° apart, and is {apart[0, 2]:.0f}° from the one and {apart[1, 2]:.0f}° from",
        f"the fastest that holds the foot up ({number(fastest.speed, 2)} m/s)",
        f"alone, which drifts backward at {number(end.speed, 2)} m/s",
    ]


def of_run_jump_in_results() -> list[str]:
    """The same in `docs/results.md`."""
    traded, blends, _ = _trained_on_both()
    slower, fastest = sorted(raised_blends(blends).both.values())
    return [
        f"{len(raised_ltes(traded).both)} of {len(traded['rewards']):,} LTEs do",
        f"two then run backward at {number(slower.speed, 2)} to {number(fastest.speed, 2)} m/s",
        f"with the hind foot at {number(fastest.height, 2)} m",
        f"alone already drifts at {number(motions_along_beta(blends)[0].speed, 2)} m/s",
    ]


def _trained_on_both() -> tuple[dict[str, Any], list[dict[str, Any]], dict[str, Any]]:
    """Returns a run's front, its blends along β, and its evaluation."""
    (run,) = RunIndex("fast").runs(RUN_JUMP, variant=BOTH)
    (traded,), (composed,), (evaluated,) = (
        run.of_seed(name, "seeds") for name in (FRONT.name, BACK_JUMPING.name, EVALUATION.name)
    )
    return traded, composed["blends"], evaluated


def of_rewards() -> list[str]:
    """Words of `docs/asking-for-behaviour.md` about the answers to twenty rewards."""
    rows = [row for row in records.read_rows(common.RESULTS / "rewards.jsonl") if not row["quick"]]
    returns = {(row["reward"], row["way"]): row["return"] for row in rows}
    searched = {reward: value for (reward, way), value in returns.items() if way == "search"}
    steps = sum({row["reward"]: row["env_steps"] / row["at_once"] for row in rows if row["way"] == "search"}.values())

    def met(way: str, shortfall: float) -> str:
        reached = [reaches(returns[reward, way], value, shortfall) for reward, value in searched.items()]
        return f"{sum(reached)} of {len(reached)}"

    return [
        f"for {met('map', 0.05)} the survey's answer returned at most 5 % less than the search's",
        f"for {met('map', 0)} at least as much",
        f"The searches took {steps:,.0f} env steps",
        f"at most 10 % less than the search's for {met('imagined', 0.1)}",
    ]


def of_courses() -> list[str]:
    """Words of `docs/asking-for-behaviour.md` about profiles and the ant's square."""
    rows = [row for row in records.read_rows(common.RESULTS / "following.jsonl") if not row["quick"]]
    newest = {(row["course"], row["way"]): row for row in rows}
    *_, slower, pursuit = (row for row in rows if row["way"] == "pursuit")
    profiles = [row for row in newest.values() if row["unit"] == "m/s"]
    spline, look_up = (
        [f"{row['error']:.2f}" for row in profiles if row["way"] == way] for way in ("spline", "look-up")
    )
    count = len(pursuit["errors"])
    met, met_before = (sum(error <= 1 for error in row["errors"]) for row in (pursuit, slower))
    seconds = [row[name] for row in profiles for name in ("first_seconds", "seconds")]
    return [
        f"after the first second was {spline[0]}, {spline[1]} and {spline[2]} m/s on three profiles",
        f"and the look-up's {look_up[0]}, {look_up[1]} and {look_up[2]}",
        f"Without a film the command took {min(seconds):.0f} to {max(seconds):.0f} s on two cores",
        f"passed within a metre of every way-point from {met} of {count} fresh starts",
        f"fell from {count - round(count * pursuit['lasted'])} of them",
        f"it turned wide, up to {max(pursuit['aside']):.1f} m from the path",
        f"it missed a way-point by {newest[pursuit['course'], 'look-up']['error']:.1f} m",
        f"passed every way-point from {met_before} of {len(slower['errors'])}",
    ]
