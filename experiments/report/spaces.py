"""The table of measures of EAR's spaces of LTEs, for every recorded run that has been measured."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from experiments.paper import EAR_VARIANTS, FAMILIES, REACH
from experiments.report.blocks import Block, Table
from experiments.report.formatting import MISSING, NAMES, VARIANTS, number, spread
from experiments.report.run_index import Run, RunIndex

MEASURES = ("space", "smooth", "lasting", "covered", "ordered")
READ = (
    "Smooth: the slope of an ideal space, which spreads the commanded range evenly over half a great circle, as a "
    "share of the slope that 95 % of neighbouring LTEs stay below, at most 1. Lasting: the share of LTEs whose "
    "episodes last. Covered: the share of the commanded range that lasting LTEs meet within 1 %. Ordered: the "
    "rank correlation of the training tasks' distances in target and in angle. Space: the geometric mean of the "
    "four. Lipschitz: the steepest slope between neighbouring LTEs, in commanded units per radian. Each run was "
    "played under 300 LTEs spread over the sphere, one episode each. Without normalisation LTEs lie on no sphere; "
    "they were played on that of their mean length."
)


def spaces(index: RunIndex) -> list[Block]:
    """Returns the measures of each family and variant over seeds, and those of each run."""
    rows, each = [], []
    for family in (*FAMILIES, REACH):
        for variant in EAR_VARIANTS:
            runs = index.runs(family, variant=variant)
            measured = [space for run in runs if (space := _space(run))]
            name = NAMES[family] + VARIANTS[variant]
            if measured:
                means = [spread([space[measure] for space in measured], 2) for measure in MEASURES]
                steepest = spread([space["lipschitz"] for space in measured], 1)
                rows.append([name, str(len(measured)), *means, steepest])
            each += [[f"{run.name}, seed {run.seed}", *_cells(_space(run))] for run in runs]
    if not rows:
        return ["Not measured yet."]
    columns = (*MEASURES, "Lipschitz")
    return [
        READ,
        *(sentence for family in (*FAMILIES, REACH) for sentence in _ablations(index, family)),
        Table("Spaces of LTEs, mean ± standard deviation over seeds.", ("method", "seeds", *columns), rows),
        Table("Each run.", ("run", *columns), each, folded=True),
    ]


def _ablations(index: RunIndex, family: str) -> list[str]:
    """Returns a sentence on a family's spaces with and without LTE noise and normalisation; none without ablations."""
    of_variants = {
        variant: [space for run in index.runs(family, variant=variant) if (space := _space(run))]
        for variant in ("", "+no-noise", "+no-norm", "+no-noise+no-norm")
    }
    measured = {VARIANTS[variant]: spaces for variant, spaces in of_variants.items() if spaces}
    if len(measured) < 2 or "" not in measured:
        return []
    told = []
    for measure in ("smooth", "covered", "ordered", "space"):
        means = [f"{_mean(spaces, measure)}{name or ' with both'}" for name, spaces in measured.items()]
        told.append(f"{measure} {', '.join(means)}")
    return [f"{NAMES[family]}, LTE noise and normalisation: {'; '.join(told)}."]


def _mean(spaces: Sequence[dict[str, Any]], measure: str) -> str:
    return number(float(np.mean([space[measure] for space in spaces])), 2)


def _space(run: Run) -> dict[str, Any] | None:
    return next((entry["space"] for entry in run.of_seed("space", "seeds")), None)


def _cells(space: dict[str, Any] | None) -> list[str]:
    return [number(space[name], 2) if space else MISSING for name in (*MEASURES, "lipschitz")]
