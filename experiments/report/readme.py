"""The parts of `README.md` and `docs/results.md` that are generated from the records, each between two markers."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from pathlib import Path

import numpy as np

from ear_jax import pretrained
from ear_jax.cli.interpolate import InterpolateCommand
from ear_jax.cli.refine import RefineCommand
from ear_jax.embeddings.interpolate import FRESH, MID_TASK_RANGE, REACHED
from ear_jax.embeddings.map import PLACES
from experiments.paper import (
    ADAPTATION,
    ANT,
    CHEETAH,
    EXPERIMENTS,
    FAMILIES,
    GATHERED,
    REACH,
    REFINED_INTERPOLATION,
    REFINEMENT,
    RUN_JUMP,
    TURNED,
    WIDE,
    episodes,
)
from experiments.report import documents, markdown
from experiments.report.blocks import Table
from experiments.report.comparison import comparison, standing
from experiments.report.formatting import MISSING, NAMES, VARIANTS, count, label, number, percent, printed, span, spread
from experiments.report.measures import (
    fresh_error,
    mean_return,
    paper_budget,
    paper_counts,
    paper_return,
    refined_returns,
    refinements,
    returns,
    successes,
    unit,
)
from experiments.report.run_index import Run, RunIndex
from experiments.report.sections import TABLES, describe_machine, machine, title

ROOT = Path(__file__).parents[2]
README, DETAILS = ROOT / "README.md", ROOT / "docs" / "results.md"
HEADLINE, RESULTS = "headline", "results"  # the names of the markers
SHOWN = (*FAMILIES, RUN_JUMP, REACH)
BLENDED = ("fresh", "mid_task", "one_to_one")
COUNTED = ("again", "midway", "between")  # the same in the tables' heads
COLUMNS = ("family", "return", "refined", "paper's return", *COUNTED, "seeds", "minutes a seed", "`ear train`")
PLAYED = f"{InterpolateCommand.episodes} episodes"  # of each blend
DETAILED_COLUMNS = ("family", "return", "paper's return", *COUNTED, "error from a map", "minutes a seed")


def rewrite(index: RunIndex) -> list[Path]:
    """Writes the generated parts of both documents.

    Raises:
      RunError: a document lacks its markers or cannot be written.
    """
    documents.put(README, HEADLINE, headline(index))
    documents.put(README, RESULTS, results(index))
    documents.put(DETAILS, RESULTS, details(index))
    return [README, DETAILS]


def headline(index: RunIndex) -> str:
    """Returns README's first result: how often a blend of the cheetah's speeds works, and what the policy returns."""
    runs, paper = index.runs(CHEETAH), paper_return(CHEETAH, "ear")
    again, error = successes(runs, "fresh"), fresh_error(CHEETAH, runs)
    met, theirs = successes(runs, "mid_task"), paper_counts(CHEETAH, "mid_task")
    if not (met and again and error is not None and theirs and paper):
        return "HalfCheetah-Vel has no analysed run yet."
    level = {1: "above", 0: "level with", -1: "short of"}[standing([mean_return(run) for run in runs], paper)]
    steps = float(np.mean([run.last["env_steps"] for run in runs])) / paper_budget(CHEETAH)[0]
    return (
        f"**HalfCheetah-Vel: for {again} pairs of neighbouring trained speeds, a blend runs at the speed midway**, to "
        f"within {number(REACHED, 2)} {unit(CHEETAH)} in the mean of {FRESH} fresh episodes; over all pairs the mean "
        f"error is {number(error, 2)} {unit(CHEETAH)}. On the {PLAYED} by which the blend was chosen: {met} "
        f"(the paper: {printed(theirs)}). On the trained speeds the policy returns {returns(runs)}, {level} the "
        f"paper's {printed(paper)}, after {percent(steps, 0)} of the paper's env steps{_time(runs)}.{_refined(runs)}"
    )


def _refined(runs: Sequence[Run]) -> str:
    """Returns a sentence on `ear refine`, or nothing if no run was refined."""
    found = refinements(runs)
    if not found:
        return ""
    before, after = (spread([entry[when] for entry in found]) for when in ("before", "after"))
    played = [run.document(REFINEMENT.name)["env_steps"] for run in runs if refinements([run])]
    share = percent(float(np.mean(played)) / paper_budget(CHEETAH)[0], 0)
    which = "the seeds" if len(found) == len(runs) else f"{len(found)} of the {len(runs)} seeds"
    return f" `ear refine` takes {which} from {before} to {after}, with another {share} of the paper's env steps."


def results(index: RunIndex) -> str:
    """Returns README's table: EAR beside the paper, with a row for each family."""
    rows = []
    for family, variant in product(SHOWN, TURNED):
        runs = index.runs(family, variant=variant)
        if runs:
            name, returned = NAMES[family] + VARIANTS[variant], spread([mean_return(run) for run in runs])
            blended = [_successes(family, runs, measure, refined=True).replace(" of ", "/") for measure in BLENDED]
            words = f"`{family}{f' --preset {index.preset}{variant}' if variant else ''}`"
            last = count(len(runs)), _minutes(runs).replace(" to ", "–") or MISSING, words
            rows.append([name, returned, refined_returns(runs), _paper_return(family), *blended, *last])
    return f"{markdown.table(Table('', COLUMNS, rows))}\n\n{RETURN} {REFINED} {BLENDS} After an arrow: refined."


RETURN = (
    f"*Return*: the mean over the training tasks, from {episodes(CHEETAH)} episodes each (the ant: {episodes(ANT)}), ± "
    "over seeds."
)
REFINED = (
    f"*Refined*: the return from {RefineCommand.episodes} fresh episodes a task after `ear refine` with [each family's "
    "options](docs/refining.md#what-it-gives), which takes more env steps. If only some seeds were refined: the return "
    "of those seeds, before → after."
)
BLENDS = (
    "*Again*: pairs of neighbouring tasks for which the blend that came nearest to the value midway, whatever its β, "
    f"meets it in the mean of {FRESH} fresh episodes, to within {100 * REACHED:g} % of the distance between the two "
    f"tasks. *Midway*: pairs for which some blend with β from {MID_TASK_RANGE[0]:g} to {MID_TASK_RANGE[1]:g} does so "
    f"in the mean of {PLAYED}. *Between*: pairs whose half-and-half blend lies between the two. In brackets: the paper."
)
FROM_A_MAP = (
    f"*Error from a map*: the mean error on tasks never trained on, when their LTEs are read off one map of {PLACES} "
    "episodes."
)


def details(index: RunIndex) -> str:
    """Returns all of `docs/results.md` that is generated: our runs, the comparison in words, and every table."""
    compared = comparison(index)
    parts = [*_our_runs(index), *_methods(index), f"## {compared.title}", *map(markdown.block, compared.blocks)]
    for id, build in TABLES.items():
        parts += [f"## {title(EXPERIMENTS[id])}", *map(markdown.block, build(index))]
    return "\n\n".join(parts)


def _our_runs(index: RunIndex) -> list[str]:
    """Returns the section on EAR: every family and variant, their budgets, machines, and notes on single runs."""
    runs = {family: index.runs(family) for family in SHOWN}
    variants = [(family, variant) for family in SHOWN for variant in (*TURNED, WIDE, GATHERED)]
    rows = [_detailed(*method, shown) for method in variants if (shown := index.runs(method[0], variant=method[1]))]
    parts = [
        "## EAR on every family",
        markdown.table(Table("", DETAILED_COLUMNS, rows)),
        f"{RETURN} {BLENDS} {FROM_A_MAP}",
        _budget(runs),
        *_shipped(index),
        *_machines([run for family in SHOWN for run in runs[family]]),
        *(_note(run) for family in SHOWN for run in runs[family]),
    ]
    return [part for part in parts if part]


def _methods(index: RunIndex) -> list[str]:
    """Returns the section on the other methods and on EAR with a part left out."""
    return [
        "## Other methods",
        "HalfCheetah-Vel: other methods, and EAR-SAC with a part left out.",
        markdown.table(Table("", ("method", "return", "paper's return", "updates"), _method_rows(index))),
        "In the authors' older code the replay holds zeros in place of the one-hot, which would explain the returns of "
        "the paper's OHE-SAC. Ours, with its one-hot and with the one-hot zeroed, beside it:",
        markdown.table(Table("", ("family", "OHE-SAC", "one-hot zeroed", "the paper's"), _one_hot_rows(index))),
    ]


def _detailed(family: str, variant: str, runs: list[Run]) -> list[str]:
    return [
        NAMES[family] + VARIANTS[variant],
        returns(runs),
        _paper_return(family),
        *(_successes(family, runs, measure) for measure in BLENDED),
        _error_from_map(family, runs),
        _minutes(runs) or MISSING,
    ]


def _paper_return(family: str) -> str:
    paper = paper_return(family, "ear")
    without = "only a curve" if family == REACH else MISSING
    return printed(paper) if paper else without


def _minutes(runs: Sequence[Run]) -> str:
    """Returns the minutes that seeds trained alone took, as a range; empty where all were trained side by side."""
    alone = [run.minutes for run in runs if run.config.seeds == 1]
    return span(alone, lambda minutes: number(minutes, 0)) if alone else ""


def _time(runs: Sequence[Run]) -> str:
    """Returns the end of a sentence on the time a seed took by itself; empty where all were trained side by side."""
    cores = {run.about["machine"]["cores"] for run in runs if run.config.seeds == 1}
    if not cores:
        return ""
    alone = [run for run in runs if run.config.seeds == 1]
    where = "one CPU core" if cores == {1} else "a CPU"
    some = f" ({len(alone)} of the seeds)" if len(alone) < len(runs) else ""
    return f": {_minutes(runs)} minutes a seed on {where}{some}"


def _successes(family: str, runs: list[Run], measure: str, refined: bool = False) -> str:
    counted, theirs = successes(runs, measure), paper_counts(family, measure)
    after = successes(runs, measure, REFINED_INTERPOLATION.name) if refined else None
    shown = (str(counted) if counted else MISSING) + (f" → {after}" if after else "")
    return shown + (f" ({printed(theirs)})" if theirs else "")


def _error_from_map(family: str, runs: list[Run]) -> str:
    tasks = [task for run in runs for task in run.of_seed(ADAPTATION.name, "tasks")]
    errors = [task["zero_shot"]["error"] for task in tasks if task.get("zero_shot")]
    if not errors:
        return MISSING
    some = f" ({len(errors)} of {len(tasks)} tasks)" if len(errors) < len(tasks) else ""
    return f"{number(float(np.mean(errors)), 2)} {unit(family)}{some}"


def _budget(runs: dict[str, list[Run]]) -> str:
    """Returns a sentence on the env steps and updates of a run of each family; empty without runs."""
    budgets = []
    for family in FAMILIES:
        if runs[family]:
            steps, updates = paper_budget(family)
            last = runs[family][0].last
            shares = percent(last["env_steps"] / steps, 0), percent(last["updates"] / updates, 0)
            budgets.append(
                f"{NAMES[family]} {count(last['env_steps'])} ({shares[0]}) and {count(last['updates'])} ({shares[1]})"
            )
    if not budgets:
        return ""
    return (
        f"Env steps and updates of a seed, in brackets as a share of the paper's: {'; '.join(budgets)}. The paper "
        "states no env steps; they are counted as its released code collects them, an episode of each task in an epoch."
    )


def _shipped(index: RunIndex) -> list[str]:
    """Returns a paragraph for each shipped agent whose run is not in the table: its training and its return."""
    listed = {run.name for run in index.all()}
    return [
        f"`{pretrained.PREFIX}{card['name']}` comes from a run that is not in the table: seed {card['seed']} of "
        f"`{card['command']}`, {count(card['env_steps'])} env steps and {count(card['updates'])} updates in "
        f"{number(card['minutes'])} minutes on {describe_machine(card['machine'], card['side_by_side'])}. Its return "
        f"is {number(card['mean_return'])}."
        for card in map(pretrained.card, pretrained.names())
        if card["record"] not in listed
    ]


def _method_rows(index: RunIndex) -> list[list[str]]:
    rows = []
    for method in EXPERIMENTS["agents"].methods:
        runs, paper = index.of(method), None if method.variant else paper_return(method.family, method.agent)
        updates = span([run.last["updates"] for run in runs], count) if runs else MISSING
        rows.append([label(method), returns(runs), printed(paper) if paper else MISSING, updates])
    return rows


def _one_hot_rows(index: RunIndex) -> list[list[str]]:
    rows = []
    for family in FAMILIES:
        ours = [returns(index.runs(family, agent)) for agent in ("onehot", "onehot-blind")]
        paper = paper_return(family, "onehot")
        rows.append([NAMES[family], *ours, printed(paper) if paper else MISSING])
    return rows


def _machines(runs: list[Run]) -> list[str]:
    """Returns a sentence on the machines the families were trained on; nothing without runs."""
    families: dict[str, list[str]] = {}
    for run in runs:
        together = f" in {number(run.minutes)} minutes" if run.config.seeds > 1 else ""
        families.setdefault(machine(run) + together, []).append(NAMES[run.config.family])
    trained = "; ".join(f"{', '.join(dict.fromkeys(names))} on {where}" for where, names in families.items())
    return [f"Trained on shared machines: {trained}."] if trained else []


def _note(run: Run) -> str:
    """Returns a sentence on a run that was stopped early or whose preset has changed since; otherwise empty."""
    last, config, notes = run.last, run.config, []
    if last["epoch"] < config.epochs and not (config.minutes and last["seconds"] >= 60 * config.minutes):
        notes.append(f"was stopped at epoch {count(last['epoch'])} of {count(config.epochs)}")
    if run.changes:
        settings = ", ".join(f"`{name}` {value}" for name, value in run.changes.items())
        notes.append(f"has settings that differ from today's `{config.preset}`: {settings}")
    return f"`{run.name}`, of commit {run.about['commit']}, {'; it '.join(notes)}." if notes else ""
