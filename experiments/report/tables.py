"""The paper's tables of returns, successes and failures beside ours."""

from __future__ import annotations

from collections.abc import Sequence

from experiments.paper import ANT, EXPERIMENTS, FAMILIES, REACH, WIDE, Method, numbers
from experiments.report.blocks import Block, Table
from experiments.report.formatting import (
    MISSING,
    NAMES,
    NO_RUN,
    count,
    interval,
    label,
    lack,
    number,
    printed,
    seeds,
    span,
    spread,
)
from experiments.report.measures import (
    Count,
    failed_tasks,
    gaps,
    goal_distances,
    mean_return,
    paper_budget,
    paper_counts,
    paper_recount,
    paper_return,
    returns,
    score_table,
    successes,
)
from experiments.report.run_index import Run, RunIndex
from experiments.statistics import interquartile_mean, probability_of_improvement

MEASURES = {"mid_task": "mid-task", "one_to_one": "1:1"}
HEADS = ("ours", "IQM [95 %]", "P(EAR better) [95 %]", "seeds", "env steps", "updates", "minutes")
INTERPOLATED = (
    "Pairs of neighbouring tasks between which interpolation succeeds, all seeds together. Mid-task: some β between "
    "0.1 and 0.9 meets the value midway, to 5 % of the distance between the two. 1:1: at β = ½ the outcome lies "
    "between them."
)


def all_returns(found: RunIndex) -> list[Block]:
    """Table 1, a table a family."""
    methods = EXPERIMENTS["table-1"].methods
    return [_family_returns(found, family, [one for one in methods if one.family == family]) for family in FAMILIES]


def agents(found: RunIndex) -> list[Block]:
    """Ours: every agent and variant on one family."""
    methods = EXPERIMENTS["agents"].methods
    ablated = {label(method): found.of(method) for method in methods if method.agent == "ear"}
    blended = [[name, *(share(runs, successes(runs, what)) for what in MEASURES)] for name, runs in ablated.items()]
    return [
        _family_returns(found, methods[0].family, list(methods)),
        Table(INTERPOLATED, ("method", *MEASURES.values()), blended),
    ]


def variants(id: str, found: RunIndex) -> list[Block]:
    """Ours: every family as the preset has it and as a variant of it does."""
    rows = []
    for method in EXPERIMENTS[id].methods:
        runs = found.of(method)
        blended = (share(runs, successes(runs, what)) for what in MEASURES)
        widest = [f"{max(apart):.0f}°" for run in runs if len(apart := gaps(run))]
        minutes = budget(runs)[-1] if runs else MISSING
        told = (returns(runs), *blended, ", ".join(widest) or MISSING, share(runs, failed_tasks(runs)), minutes)
        rows.append([NAMES[method.family], label(method), *told])
    columns = ("return", *MEASURES.values(), "widest gap", "tasks with an episode that ends early", "minutes")
    caption = (
        "Returns, pairs of neighbours that blend, the widest angle between the LTEs of such a pair in each seed, and "
        "failures."
    )
    return [Table(caption, ("family", "method", *columns), rows)]


def reach(found: RunIndex) -> list[Block]:
    """Ours: Metaworld-Reach, of which the paper has curves and no numbers."""
    methods, runs = EXPERIMENTS["reach"].methods, found.runs(REACH)
    caption = (
        f"{NAMES[REACH]}: return, mean over the training goals; each of 200 steps is worth 10 within 5 cm of the goal. "
        "As `ear evaluate` has it, or else the last evaluation of training."
    )
    returned = [_method_returns(method, found.of(method), runs) for method in methods]
    blended = [[name, share(runs, successes(runs, what))] for what, name in MEASURES.items()]
    reached = [_goals_reached(label(method), found.of(method)) for method in methods]
    return [
        Table(caption, ("method", "paper", *HEADS), returned),
        Table(
            "Goals within 5 cm of the fingertips' mean place in the second half of episodes, and how far it is off.",
            ("method", "goals", "cm, mean", "cm, worst"),
            reached,
        ),
        Table(f"{INTERPOLATED} The value is an angle, on the ellipse of goals.", ("measure", "ours"), blended),
    ]


def _goals_reached(name: str, runs: Sequence[Run]) -> list[str]:
    off = [distance for run in runs for distance in goal_distances(run)]
    if not off:
        return [name, lack(runs), MISSING, MISSING]
    within = sum(distance <= 0.05 for distance in off)  # where Meta-World's reward is full, and its success
    return [name, f"{within} of {len(off)}", number(100 * sum(off) / len(off)), number(100 * max(off))]


def _family_returns(found: RunIndex, family: str, methods: list[Method]) -> Table:
    steps, updates = paper_budget(family)
    caption = (
        f"{NAMES[family]}: return, mean over the training tasks. The paper: 3 seeds, for EAR-SAC {count(steps)} env "
        f"steps and {count(updates)} updates. Ours: as `ear evaluate` has it, or else the last evaluation of training."
    )
    rows = [_method_returns(method, found.of(method), found.runs(family)) for method in methods]
    return Table(caption, ("method", "paper", *HEADS), rows)


def _method_returns(method: Method, runs: list[Run], ear: list[Run]) -> list[str]:
    paper = paper_return(method.family, method.agent) if method.variant in ("", WIDE) else None
    cells = [label(method), printed(paper) if paper else MISSING]
    if not runs:
        return [*cells, NO_RUN, *[MISSING] * 6]
    scores, better = score_table(runs), MISSING
    if ear and runs != ear:
        better = interval(probability_of_improvement, score_table(ear), scores, digits=2)
    reached = spread([mean_return(run) for run in runs])
    return [*cells, reached, interval(interquartile_mean, scores), better, seeds(runs), *budget(runs)]


def budget(runs: Sequence[Run]) -> list[str]:
    """Environment steps, updates and minutes of a method's runs, each from the least to the most."""
    return [
        span([run.last["env_steps"] for run in runs], count),
        span([run.last["updates"] for run in runs], count),
        span([run.minutes for run in runs], number),
    ]


def interpolation_counts(found: RunIndex) -> list[Block]:
    """Table 5."""
    rows = []
    for family in FAMILIES:
        runs = found.runs(family)
        for what, name in MEASURES.items():
            theirs = printed(paper_counts(family, what)), str(paper_recount(family, what))
            rows.append([NAMES[family], name, *theirs, share(runs, successes(runs, what))])
    note = "Recounted: by this rule from the paper's own tables 11 to 18, from which its table 5 does not quite follow."
    return [Table(INTERPOLATED, ("family", "measure", "paper", "paper, recounted", "ours"), rows), note]


def share(runs: Sequence[Run], counted: Count | None) -> str:
    """How many of how many, and of how many seeds."""
    return f"{counted} ({seeds(counted.seeds)})" if counted else lack(runs)


def episode_ends(found: RunIndex) -> list[Block]:
    """Table 7."""
    ((which, trajectories),) = numbers()["table-7"]["panels"].items()
    paper = [printed(steps) for _, steps in trajectories]
    rows = [[f"paper, {which}", *paper]]
    for run in found.runs(ANT, "ear", "+no-noise"):
        for one in run.of_seed("evaluation", "seeds"):
            same = next(task for task in one["tasks"] if which.startswith(f"{task['name']},"))
            worst = min(one["tasks"], key=lambda task: sum(task["episodes"]["length"]))
            for task in {task["name"]: task for task in (same, worst)}.values():
                lengths = [count(length) for length in task["episodes"]["length"]][: len(paper)]
                missing = [MISSING] * (len(paper) - len(lengths))
                rows.append([f"ours, {task['name']}, seed {run.seed}", *lengths, *missing])
    if len(rows) == 1:
        rows.append(["ours", lack(found.runs(ANT, "ear", "+no-noise")), *[MISSING] * (len(paper) - 1)])
    caption = "Steps after which episodes of Ant-Dir end; of ours the paper's task, and that of the shortest."
    return [Table(caption, ("trajectory", *map(str, range(1, len(paper) + 1))), rows)]


def failures(found: RunIndex) -> list[Block]:
    """Table 8."""
    rows = []
    for (policy, paper), variant in zip(numbers()["table-8"]["panels"][""], ("+no-noise", ""), strict=True):
        runs = found.runs(ANT, "ear", variant)
        rows.append([policy, printed(paper), share(runs, failed_tasks(runs))])
    return [Table("Tasks of Ant-Dir with an episode that ends early.", ("policy", "paper", "ours"), rows)]


def normalisation(found: RunIndex) -> list[Block]:
    """Table 9."""
    rows = []
    for line, variant in zip(numbers()["table-9"]["panels"][""], ("+no-norm", ""), strict=True):
        runs = found.runs(ANT, "ear", variant)
        ours = [share(runs, successes(runs, what)) for what in MEASURES]
        rows.append([line[0], printed(line[1]), ours[0], printed(line[2]), ours[1]])
    columns = ("policy", "mid-task, paper", "mid-task, ours", "1:1, paper", "1:1, ours")
    return [Table("Pairs of neighbouring tasks of Ant-Dir between which interpolation succeeds.", columns, rows)]
