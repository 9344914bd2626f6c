"""The table of measures of EAR's spaces of LTEs, for every recorded run that has been measured."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ear_jax.embeddings.space import TOLERANCE
from experiments.paper import EAR_VARIANTS, FAMILIES, REACH, RUN_JUMP
from experiments.report.blocks import Block, Table
from experiments.report.formatting import NAMES, VARIANTS, number, spread
from experiments.report.run_index import Run, RunIndex, recorded_runs
from experiments.space import PLACES

ALL = (*FAMILIES, RUN_JUMP, REACH)
MEASURES = ("space", "smooth", "lasting", "covered", "ordered")
READ = (
    "Smooth: how evenly the outcome changes over the sphere. It is the slope of an ideal space, the whole commanded "
    "range over half a great circle, divided by the slope that 95 % of neighbouring LTEs stay below, and at most 1. "
    "Lasting: the share of LTEs whose episodes last. Covered: the share of the commanded range that lasting LTEs meet "
    f"within {100 * TOLERANCE:g} %. Ordered: the rank correlation of the training tasks' distances in target and in "
    "angle. Space: the geometric mean of the four. Lipschitz: the steepest slope between neighbouring LTEs, in "
    f"commanded units per radian. Each run was played under {PLACES} LTEs spread over the sphere, one episode each. "
    "Without normalisation LTEs differ in length; LTEs of their mean length were played."
)


def spaces(index: RunIndex) -> list[Block]:
    """Returns the measures of each family and variant over seeds, and those of each run."""
    rows = []
    for family in ALL:
        for variant in EAR_VARIANTS:
            measured = [space for run in index.runs(family, variant=variant) if (space := _space(run))]
            name = NAMES[family] + VARIANTS[variant]
            if measured:
                means = [spread([space[measure] for space in measured], 2) for measure in MEASURES]
                steepest = spread([space["lipschitz"] for space in measured], 1)
                rows.append([name, str(len(measured)), *means, steepest])
    recorded = recorded_runs()
    each = [
        [f"{run.name}, seed {run.seed}", *(number(space[measure], 2) for measure in (*MEASURES, "lipschitz"))]
        for family in ALL
        for run in recorded
        if run.config.family == family and (space := _space(run))
    ]
    if not rows:
        return ["Not measured yet."]
    columns = (*MEASURES, "Lipschitz")
    return [
        READ,
        *(sentence for family in ALL for sentence in _ablations(index, family)),
        Table("Spaces of LTEs, mean ± standard deviation over seeds.", ("method", "seeds", *columns), rows),
        Table("Every recorded run.", ("run", *columns), each, folded=True),
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
