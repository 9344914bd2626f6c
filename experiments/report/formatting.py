"""Numbers and names as text."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ear_jax.runs.statistics import bootstrap_interval
from experiments.paper import Method

MISSING = "—"
NO_RUN = "—, no run yet"
NO_ANALYSIS = "—, not analysed yet"
NAMES = {
    "halfcheetah-vel": "HalfCheetah-Vel",
    "ant-dir": "Ant-Dir",
    "hopper-vel": "Hopper-Vel",
    "walker-vel": "Walker-Vel",
    "halfcheetah-run-jump": "HalfCheetah-Run-Jump",
    "reach": "Metaworld-Reach",
    "ear": "EAR-SAC",
    "ear-rnn": "EAR-SAC, recurrent",
    "maml": "MAML",
    "pearl": "PEARL",
    "multihead": "MHMT-SAC",
    "onehot": "OHE-SAC",
    "onehot-blind": "OHE-SAC, one-hot zeroed",
}


VARIANTS = {
    "": "",
    "+no-noise": " without LTE noise",
    "+no-norm": " without normalisation",
    "+no-noise+no-norm": " without either",
    "+wide": ", twice as wide",
    "+gathered": ", LTEs gathered at the start",
    "+categorical": ", categorical critics",
    "+equivariant": ", equivariant",
    "+both": ", trained also on tasks that reward both",
}


def label(method: Method) -> str:
    """Returns the name of an agent and of its variant."""
    return NAMES[method.agent] + VARIANTS[method.variant]


def number(value: float, digits: int = 1) -> str:
    """Formats a number with a typographic minus, thousands separators and no negative zero."""
    return f"{value:z,.{digits}f}".replace("-", "−")


def count(value: int) -> str:
    return f"{value:,}"


def seeds(runs: Sequence[Any]) -> str:
    return "1 seed" if len(runs) == 1 else f"{len(runs)} seeds"


def percent(share: float, digits: int = 1) -> str:
    return f"{100 * share:.{digits}f} %"


def lack(runs: Sequence[Any]) -> str:
    """Returns the reason a result is missing, given the runs that exist."""
    return NO_ANALYSIS if runs else NO_RUN


def spread(values: Sequence[float], digits: int = 1) -> str:
    """Formats mean ± sample standard deviation over seeds, or the value of a single seed."""
    if len(values) == 1:
        return number(values[0], digits)
    return f"{number(float(np.mean(values)), digits)} ± {number(float(np.std(values, ddof=1)), digits)}"


def printed(cell: Any) -> str:
    """Formats a cell of `paper.json`."""
    if isinstance(cell, dict) and "mean" in cell:
        return f"{number(cell['mean'])} ± {number(cell['std'], 2)}"
    if isinstance(cell, dict):
        done, total = cell.values()
        return f"{done} of {total}"
    if isinstance(cell, str):
        return cell
    return f"{cell:g}".replace("-", "−")


def interval(statistic: Callable[..., np.ndarray], *scores: np.ndarray, digits: int = 1) -> str:
    """Formats a statistic of scores [seeds, tasks] with its 95 % interval; a dash for a single seed."""
    if min(map(len, scores)) < 2:
        return MISSING
    low, high = bootstrap_interval(statistic, *scores)
    return f"{number(float(statistic(*scores)), digits)} [{number(low, digits)}, {number(high, digits)}]"


def span(values: Sequence[float], show: Callable[[Any], str]) -> str:
    """Formats a range: one value, or the least and the most of several."""
    low, high = min(values), max(values)
    return show(low) if low == high else f"{show(low)} to {show(high)}"
