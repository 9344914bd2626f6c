"""The paper's comparisons of its method with and without a part, and what our runs show of each."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from experiments.paper import ADAPTATION, ANT, FAMILIES, numbers
from experiments.report.formatting import MISSING, NAMES, number, printed
from experiments.report.measures import chance_of_more, failed_tasks, successes
from experiments.report.run_index import RunIndex

THIRD = 3  # epochs of search after which the paper's returns are level
WITHOUT_NORM, WITH_NORM = 0, 1  # rows of the paper's table 9


def claims(index: RunIndex) -> list[str]:
    """Returns a sentence or two on each comparison that has runs."""
    return [*_embedding(index), *_noise(index), *_normalisation(index), *_search(index)]


def _embedding(index: RunIndex) -> Iterator[str]:
    pairs = {family: chance_of_more(index.runs(family), index.runs(family, "onehot")) for family in FAMILIES}
    if found := [f"{chance} on {NAMES[family]}" for family, chance in pairs.items() if chance not in (None, MISSING)]:
        yield (
            "Embeddings in place of a one-hot: in the paper EAR-SAC returns far more than OHE-SAC. Here the "
            "probability that a seed of EAR-SAC returns more than one of OHE-SAC on the same task is "
            f"{', '.join(found)}; chance is 0.5."
        )


def _noise(index: RunIndex) -> Iterator[str]:
    without, with_noise = (failed_tasks(index.runs(ANT, variant=variant)) for variant in ("+no-noise", ""))
    if without and with_noise:
        theirs = [printed(paper) for _, paper in numbers()["table-8"]["panels"][""]]
        yield (
            f"LTE noise against failures: in the paper {theirs[0]} tasks of Ant-Dir have an episode that ends early "
            f"without it and {theirs[1]} with it. Here {without} have one without it and {with_noise} with it."
        )


def _normalisation(index: RunIndex) -> Iterator[str]:
    measures = ("mid_task", "one_to_one")
    ours = [
        [successes(index.runs(ANT, variant=variant), measure) for measure in measures] for variant in ("+no-norm", "")
    ]
    if all(map(all, ours)):
        theirs = [[printed(cell) for cell in row[1:]] for row in numbers()["table-9"]["panels"][""]]
        yield (
            "Normalisation for blends of neighbouring tasks of Ant-Dir, mid-task and 1:1: in the paper "
            f"{_both(theirs[WITHOUT_NORM])} pairs succeed without it and {_both(theirs[WITH_NORM])} with it, here "
            f"{_both(ours[WITHOUT_NORM])} without it and {_both(ours[WITH_NORM])} with it."
        )


def _both(counts: Sequence[object]) -> str:
    return " and ".join(map(str, counts))


def _search(index: RunIndex) -> Iterator[str]:
    found = []
    for family in FAMILIES:
        tasks = [task for run in index.runs(family) for task in run.of_seed(ADAPTATION.name, "tasks")]
        curves = [[epoch["reevaluated"] for epoch in task["epochs"]] for task in tasks if task["epochs"]]
        if curves:
            after, at_last = np.mean([[curve[min(THIRD, len(curve)) - 1], curve[-1]] for curve in curves], axis=0)
            found.append(f"{number(after)} and {number(at_last)} on {NAMES[family]}")
    if found:
        yield (
            f"A short search: in the paper adaptation is over after {THIRD} epochs. Here the best LTEs of epoch "
            f"{THIRD} and of the last one return {', '.join(found)}, in fresh episodes of tasks never trained on."
        )
