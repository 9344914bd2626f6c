"""README's tables of results and `docs/results.md`, made from the records, between two markers each."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ear_jax import pretrained
from experiments.paper import ADAPTATION, EXPERIMENTS, FAMILIES, GATHERED, REACH, RUN_JUMP, WIDE
from experiments.report import documents, markdown
from experiments.report.blocks import Table
from experiments.report.comparison import comparison
from experiments.report.formatting import MISSING, NAMES, VARIANTS, count, label, number, percent, printed, span
from experiments.report.measures import paper_budget, paper_counts, paper_return, returns, successes, unit
from experiments.report.run_index import Run, RunIndex
from experiments.report.sections import TABLES, describe_machine, machine, title

ROOT = Path(__file__).parents[2]
README, DETAILS = ROOT / "README.md", ROOT / "docs" / "results.md"
PLACE = "results"
TOLD = (*FAMILIES, RUN_JUMP, REACH)
COLUMNS = ("family", "return", "the paper", "midway", "between", "from a map", "minutes a seed")


def rewrite(found: RunIndex) -> list[Path]:
    """Puts the results into both documents; raises RunError where one has no place for them, or cannot be written."""
    documents.put(README, PLACE, results(found))
    documents.put(DETAILS, PLACE, details(found))
    return [README, DETAILS]


def details(found: RunIndex) -> str:
    """Every table, and in words where we agree with the paper."""
    parts = [*map(markdown.block, comparison(found).blocks)]
    for id, build in TABLES.items():
        parts += [f"## {title(EXPERIMENTS[id])}", *map(markdown.block, build(found))]
    return "\n\n".join(parts)


def results(found: RunIndex) -> str:
    """EAR on every family, all methods on the cheetah, OHE-SAC with and without its one-hot, and notes on the runs."""
    runs = {family: found.runs(family) for family in TOLD}
    methods = [(family, variant) for family in TOLD for variant in ("", WIDE, GATHERED)]
    rows = [_family(*method, shown) for method in methods if (shown := found.runs(method[0], variant=method[1]))]
    parts = [
        markdown.table(Table("", COLUMNS, rows)),
        HOW_TO_READ,
        _budget(runs),
        *_shipped(found),
        "Other methods, and EAR-SAC with a part left out, on HalfCheetah-Vel, each in the budget of `fast`:",
        markdown.table(Table("", ("method", "return", "the paper"), _methods(found))),
        "OHE-SAC, ours with its one-hot and with that zeroed, beside the paper's:",
        markdown.table(Table("", ("family", "OHE-SAC", "one-hot zeroed", "the paper's"), _one_hot(found))),
        *_machines([run for family in TOLD for run in runs[family]]),
        *(_note(run) for family in TOLD for run in runs[family]),
    ]
    return "\n\n".join(filter(None, parts))


HOW_TO_READ = (
    "*Return*: the mean over training tasks, ± over seeds. *Midway*: pairs of neighbouring tasks of which a blend "
    "meets the value midway. *Between*: pairs whose half-and-half blend lies between the two; in brackets the paper's. "
    "*From a map*: mean error on tasks never trained on, of the embedding that one map of 500 episodes gives for all."
)


def _family(family: str, variant: str, runs: list[Run]) -> list[str]:
    paper = paper_return(family, "ear")
    theirs = "a curve" if family == REACH else MISSING
    return [
        NAMES[family] + VARIANTS[variant],
        returns(runs),
        printed(paper) if paper else theirs,
        *(_successes(family, runs, what) for what in ("mid_task", "one_to_one")),
        _mapped(family, runs),
        span([run.minutes for run in runs if run.config.seeds == 1], lambda minutes: number(minutes, 0)),
    ]


def _successes(family: str, runs: list[Run], what: str) -> str:
    counted, theirs = successes(runs, what), paper_counts(family, what)
    return (str(counted) if counted else MISSING) + (f" ({printed(theirs)})" if theirs else "")


def _mapped(family: str, runs: list[Run]) -> str:
    tasks = [task for run in runs for task in run.of_seed(ADAPTATION.name, "tasks")]
    errors = [task["zero_shot"]["error"] for task in tasks if task.get("zero_shot")]
    return f"{number(float(np.mean(errors)), 2)} {unit(family)}" if errors else MISSING


def _budget(runs: dict[str, list[Run]]) -> str:
    """What a run of each family costs beside the paper's, in a sentence; empty without runs."""
    said = []
    for family in FAMILIES:
        if runs[family]:
            steps, updates = paper_budget(family)
            last = runs[family][0].last
            shares = percent(last["env_steps"] / steps, 0), percent(last["updates"] / updates, 0)
            said.append(
                f"{NAMES[family]} {count(last['env_steps'])} ({shares[0]}) and {count(last['updates'])} ({shares[1]})"
            )
    return f"Env steps and updates a seed, and of the paper's: {'; '.join(said)}." if said else ""


def _shipped(found: RunIndex) -> list[str]:
    """Of each agent that ships but is of none of the runs told of: what trained it, and what it returns."""
    told = {run.name for run in found.all()}
    return [
        f"`{pretrained.PREFIX}{card['name']}` is of a run of its own: seed {card['seed']} of `{card['command']}`, "
        f"{count(card['env_steps'])} env steps and {count(card['updates'])} updates in {number(card['minutes'])} "
        f"minutes on {describe_machine(card['machine'], card['side_by_side'])}. "
        f"It returns {number(card['mean_return'])}."
        for card in map(pretrained.card, pretrained.names())
        if card["record"] not in told
    ]


def _methods(found: RunIndex) -> list[list[str]]:
    rows = []
    for method in EXPERIMENTS["agents"].methods:
        runs = found.of(method)
        paper = None if method.variant else paper_return(method.family, method.agent)
        rows.append([label(method), returns(runs), printed(paper) if paper else MISSING])
    return rows


def _one_hot(found: RunIndex) -> list[list[str]]:
    """OHE-SAC with its one-hot and without, beside the paper's, on each family."""
    rows = []
    for family in FAMILIES:
        ours = [returns(found.runs(family, agent)) for agent in ("onehot", "onehot-blind")]
        paper = paper_return(family, "onehot")
        rows.append([NAMES[family], *ours, printed(paper) if paper else MISSING])
    return rows


def _machines(runs: list[Run]) -> list[str]:
    """What each family was trained on, in a sentence; none without runs."""
    families: dict[str, list[str]] = {}
    for run in runs:
        together = f" in {number(run.minutes)} minutes" if run.config.seeds > 1 else ""
        families.setdefault(machine(run) + together, []).append(NAMES[run.config.family])
    said = "; ".join(f"{', '.join(dict.fromkeys(names))} on {where}" for where, names in families.items())
    return [f"Trained: {said}."] if said else []


def _note(run: Run) -> str:
    """Of a run that was stopped before its end, or whose preset is another today; otherwise empty."""
    last, config, said = run.last, run.config, []
    if last["epoch"] < config.epochs and not (config.minutes and last["seconds"] >= 60 * config.minutes):
        said.append(f"was stopped at epoch {count(last['epoch'])} of {count(config.epochs)}")
    if run.changes:
        settings = ", ".join(f"`{name}` {value}" for name, value in run.changes.items())
        said.append(f"has settings that `{config.preset}` has otherwise today: {settings}")
    return f"`{run.name}`, of commit {run.made['commit']}, {'; it '.join(said)}." if said else ""
