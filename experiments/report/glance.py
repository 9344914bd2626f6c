"""The top of the report: a verdict on each claim of the paper, and all returns in one picture."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from experiments.paper import ANT, EQUIVARIANT, FAMILIES, INTERPOLATION, REFINED_INTERPOLATION
from experiments.report.blocks import Block, Picture, Table
from experiments.report.comparison import as_often, standing
from experiments.report.figures import draw_panels, returns_beside
from experiments.report.formatting import MISSING, NAMES, number, printed, spread
from experiments.report.measures import mean_return, paper_counts, paper_return, refinements, successes
from experiments.report.pictures import FOLDER
from experiments.report.run_index import Run, RunIndex

AGENTS = ("ear", "multihead", "onehot", "pearl", "maml")
REFINED = {agent: f"{NAMES[agent]}, refined" for agent in ("ear", "multihead")}
BLENDS = {"Blends: midway": "mid_task", "Blends: between": "one_to_one"}


def glance(index: RunIndex, out: Path) -> list[Block]:
    """Returns the table of verdicts, and the picture of returns, which is drawn into `out`/figures."""
    return [_verdicts(index), *_picture(index, out)]


def _runs(index: RunIndex, family: str, agent: str) -> list[Run]:
    """Returns the runs of a method on a family; on the ant those that turn with it, if there are any."""
    turning = index.runs(family, agent, EQUIVARIANT) if family == ANT else []
    return turning or index.runs(family, agent)


def _returns(index: RunIndex, family: str) -> dict[str, list[float]]:
    """Returns what each seed of each method returns, by the method's name; empty lists where nothing is recorded."""
    returns = {}
    for agent in AGENTS:
        runs = _runs(index, family, agent)
        returns[NAMES[agent]] = list(map(mean_return, runs))
        if agent in REFINED:
            returns[REFINED[agent]] = [entry["after"] for entry in refinements(runs)]
    return returns


def _paper(family: str, method: str) -> dict[str, float] | None:
    agents = {NAMES[agent]: agent for agent in AGENTS} | {name: agent for agent, name in REFINED.items()}
    return paper_return(family, agents[method])


def _verdicts(index: RunIndex) -> Table:
    returns = {family: _returns(index, family) for family in FAMILIES}
    returned = {
        method: [_of_returns(returns[family][method], _paper(family, method)) for family in FAMILIES]
        for method in returns[FAMILIES[0]]
    }
    blended = {
        name: [_of_blends(_runs(index, family, "ear"), family, measure) for family in FAMILIES]
        for name, measure in BLENDS.items()
    }
    ear = [NAMES["ear"], REFINED["ear"]]
    rows = [[name, *cells] for name, cells in ({name: returned[name] for name in ear} | blended | returned).items()]
    caption = (
        "✓: level with the paper or above it, ✗: short of it. Ours / the paper's. In brackets: our seeds; the paper "
        "has 3. Returns are means over the training tasks. Blends: pairs of neighbouring tasks for which some blend "
        "meets the value midway, or the one at β = ½ lies between the two, after refining where we refined. On the ant "
        "EAR-SAC and MHMT-SAC are the equivariant ones."
    )
    return Table(caption, ("", *(NAMES[family] for family in FAMILIES)), rows)


def _of_returns(ours: Sequence[float], paper: dict[str, float] | None) -> str:
    if not ours or not paper:
        return MISSING
    return f"{_mark(standing(ours, paper) >= 0)} {spread(ours)} ({len(ours)}) / {number(paper['mean'])}"


def _of_blends(runs: list[Run], family: str, measure: str) -> str:
    counted = successes(runs, measure, REFINED_INTERPOLATION.name) or successes(runs, measure, INTERPOLATION.name)
    theirs = paper_counts(family, measure)
    if not counted or not theirs:
        return MISSING
    return f"{_mark(as_often(counted, theirs) >= 0)} {counted} ({len(counted.seeds)}) / {printed(theirs)}"


def _mark(level: bool) -> str:
    return "✓" if level else "✗"


def _picture(index: RunIndex, out: Path) -> list[Block]:
    returns = {family: _returns(index, family) for family in FAMILIES}
    panels = [
        partial(
            returns_beside,
            title=NAMES[family],
            rows=[(method, ours, _paper(family, method)) for method, ours in by_method.items()],
        )
        for family, by_method in returns.items()
        if any(by_method.values())
    ]
    if not panels:
        return []
    draw_panels(out / FOLDER / "returns.png", panels)
    caption = (
        "Mean return over the training tasks. Dots: our seeds, filled: their mean. Diamonds: the paper, ± its standard "
        "deviation."
    )
    return [Picture(f"{FOLDER}/returns.png", caption)]
