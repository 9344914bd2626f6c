"""The paper's tables of returns, successes and failures beside ours."""

from __future__ import annotations

from collections.abc import Sequence

from ear_jax.cli.interpolate import InterpolateCommand
from ear_jax.cli.refine import RefineCommand
from ear_jax.config import env_flags
from ear_jax.embeddings.interpolate import FRESH, MID_TASK_RANGE, REACHED
from ear_jax.envs import Family
from ear_jax.envs.reach import NEAR
from ear_jax.runs.statistics import interquartile_mean
from experiments.paper import (
    ANT,
    EXPERIMENTS,
    FAMILIES,
    INTERPOLATION,
    REACH,
    REFINED_INTERPOLATION,
    REFINEMENT,
    TURNED,
    Method,
    episodes,
    numbers,
)
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
    FIRST,
    Count,
    chance_of_more,
    failed_tasks,
    fresh_error,
    gaps,
    goal_distances,
    mean_return,
    paper_budget,
    paper_counts,
    paper_recount,
    paper_return,
    recount,
    refined_returns,
    refinements,
    returns,
    score_table,
    shared_tasks,
    successes,
    unit,
)
from experiments.report.run_index import Run, RunIndex

NOT_REFINED = "—, not refined yet"
BLENDS = (INTERPOLATION.name, REFINED_INTERPOLATION.name)  # before and after a refinement
PAPERS = {"mid_task": "mid-task", "one_to_one": "1:1"}  # measures of the paper
MEASURES = {"fresh": "mid-task, again", **PAPERS}
HEADS = ("ours", "IQM [95 %]", "P(EAR better) [95 %]", "seeds", "env steps", "updates", "minutes")
INTERPOLATED = (
    "Pairs of neighbouring tasks between which interpolation succeeds, over all seeds. Mid-task: some β between "
    f"{MID_TASK_RANGE[0]:g} and {MID_TASK_RANGE[1]:g} meets the value midway, to within {100 * REACHED:g} % of the "
    f"distance between the two, in the mean of {InterpolateCommand.episodes} episodes. Again: the β that came nearest "
    f"meets it in the mean of {FRESH} fresh episodes. 1:1: the outcome at β = ½ lies between the two."
)


def all_returns(index: RunIndex) -> list[Block]:
    """Returns table 1, as one table for each family."""
    methods = EXPERIMENTS["table-1"].methods
    return [_family_returns(index, family, [one for one in methods if one.family == family]) for family in FAMILIES]


def agents(index: RunIndex) -> list[Block]:
    """Returns a table of our own: every agent and variant on one family."""
    methods = EXPERIMENTS["agents"].methods
    ablated = {label(method): index.of(method) for method in methods if method.agent == "ear"}
    blended = [
        [name, *(share(runs, successes(runs, measure)) for measure in MEASURES)] for name, runs in ablated.items()
    ]
    return [
        _family_returns(index, methods[0].family, list(methods)),
        Table(INTERPOLATED, ("method", *MEASURES.values()), blended),
    ]


def variants(id: str, index: RunIndex) -> list[Block]:
    """Returns a table of our own: each family that has runs of a variant of the preset, without it and with it."""
    methods = EXPERIMENTS[id].methods
    ran = {method.family for method in methods if method.variant and index.of(method)}
    rows = []
    for method in (method for method in methods if method.family in ran):
        runs = index.of(method)
        blended = (share(runs, successes(runs, measure)) for measure in MEASURES)
        widest = [f"{max(apart):.0f}°" for run in runs if len(apart := gaps(run))]
        minutes = budget(runs)[-1] if runs else MISSING
        failed = share(runs, failed_tasks(runs))
        cells = (returns(runs), *blended, ", ".join(widest) or MISSING, failed, minutes)
        rows.append([NAMES[method.family], label(method), *cells])
    columns = ("return", *MEASURES.values(), "widest gap", "tasks with an episode that ends early", "minutes")
    caption = (
        "Returns, pairs of neighbouring tasks that blend, the widest angle between the LTEs of neighbours in each "
        f"seed, and tasks in which at least one of the first {FIRST} episodes ends early."
    )
    table = [Table(caption, ("family", "method", *columns), rows)] if rows else []
    missing = ", ".join(NAMES[method.family] for method in methods if method.variant and method.family not in ran)
    return [*table, *([f"Not run yet: {missing}."] if missing else [])]


def refined(index: RunIndex) -> list[Block]:
    """Returns a table of our own: EAR-SAC and MHMT-SAC on every family, before and after `ear refine`."""
    rows, notes = [], []
    for method in EXPERIMENTS["refined"].methods:
        runs = [run for run in index.of(method) if refinements([run])]
        found, paper = refinements(runs), paper_return(method.family, method.agent)
        before = spread([entry["before"] for entry in found]) if found else NOT_REFINED
        blended = [_before_and_after(runs, measure) for measure in MEASURES]
        told = [run.document(REFINEMENT.name) for run in runs]
        spent = [count(told[0]["env_steps"]), span([one["seconds"] / 60 for one in told], number)] if told else []
        cells = (
            before,
            refined_returns(runs),
            printed(paper) if paper else MISSING,
            *blended,
            seeds(runs) if runs else MISSING,
            *(spent or [MISSING, MISSING]),
        )
        rows.append([NAMES[method.family], label(method), *cells])
        if options := next((one["options"] for one in told if "options" in one), {}):
            notes.append(f"{NAMES[method.family]} is refined with{env_flags(options)}; its returns are without.")
    columns = ("before", "refined", "paper", *MEASURES.values(), "seeds", "its env steps", "its minutes")
    caption = (
        f"Returns before and after `ear refine`, each from {RefineCommand.episodes} fresh episodes a task, and pairs "
        "of neighbouring tasks that blend, before → after. MHMT-SAC's heads do not blend. Last: what the refinement "
        "took."
    )
    return [Table(" ".join([caption, *dict.fromkeys(notes)]), ("family", "method", *columns), rows)]


def _before_and_after(runs: Sequence[Run], measure: str) -> str:
    """Formats how many pairs succeed before and after a refinement."""
    counts = [successes(runs, measure, document) for document in BLENDS]
    return " → ".join(str(counted or MISSING) for counted in counts) if any(counts) else MISSING


def reach(index: RunIndex) -> list[Block]:
    """Returns a table of our own: Metaworld-Reach, for which the paper has curves and no numbers."""
    methods, runs = EXPERIMENTS["reach"].methods, index.runs(REACH)
    caption = (
        f"{NAMES[REACH]}: mean return over the training goals. Each of {Family.episode_length} steps is worth 10 "
        f"within {100 * NEAR:g} cm of the goal. {_source(REACH)}"
    )
    returned = [_method_returns(method, index.of(method), runs) for method in methods]
    blended = [[name, share(runs, successes(runs, measure))] for measure, name in MEASURES.items()]
    reached = [_goals_reached(label(method), index.of(method)) for method in methods]
    return [
        Table(caption, ("method", "paper", *HEADS), returned),
        Table(
            f"Goals reached to within {100 * NEAR:g} cm, and the distance to the goal. Both by the fingertips' mean "
            "position over the second half of the episodes.",
            ("method", "goals", "cm, mean", "cm, worst"),
            reached,
        ),
        Table(f"{INTERPOLATED} The value is an angle, on the ellipse of goals.", ("measure", "ours"), blended),
    ]


def _goals_reached(name: str, runs: Sequence[Run]) -> list[str]:
    distances = [distance for run in runs for distance in goal_distances(run)]
    if not distances:
        return [name, lack(runs), MISSING, MISSING]
    reached = sum(distance <= NEAR for distance in distances)  # Meta-World's own criterion of success
    mean = sum(distances) / len(distances)
    return [name, f"{reached} of {len(distances)}", number(100 * mean), number(100 * max(distances))]


def _family_returns(index: RunIndex, family: str, methods: list[Method]) -> Table:
    steps, updates = paper_budget(family)
    caption = (
        f"{NAMES[family]}: mean return over the training tasks. The paper: {EXPERIMENTS['table-1'].seeds} seeds, for "
        f"EAR-SAC {count(steps)} env steps and {count(updates)} updates. {_source(family)}"
    )
    rows = []
    for method in methods:
        ear = index.runs(family, variant="" if method.agent == "ear" else method.variant)
        rows.append(_method_returns(method, index.of(method), ear))
    return Table(caption, ("method", "paper", *HEADS), rows)


def _source(family: str) -> str:
    """Returns where our returns of a family come from."""
    return f"Ours: {episodes(family)} episodes a task by `ear evaluate`, or else the last evaluation during training."


def _method_returns(method: Method, runs: list[Run], ear: list[Run]) -> list[str]:
    paper = paper_return(method.family, method.agent) if method.variant in TURNED else None
    cells = [label(method), printed(paper) if paper else MISSING]
    if not runs:
        return [*cells, NO_RUN, *[MISSING] * 6]
    scores = score_table(runs, shared_tasks(runs))
    better = (None if runs == ear else chance_of_more(ear, runs)) or MISSING
    returned = spread([mean_return(run) for run in runs])
    return [*cells, returned, interval(interquartile_mean, scores), better, seeds(runs), *budget(runs)]


def budget(runs: Sequence[Run]) -> list[str]:
    """Returns env steps, updates and minutes of a method's runs, each as a range."""
    return [
        span([run.last["env_steps"] for run in runs], count),
        span([run.last["updates"] for run in runs], count),
        span([run.minutes for run in runs], number),
    ]


def interpolation_counts(index: RunIndex) -> list[Block]:
    """Returns table 5."""
    rows = []
    for family in FAMILIES:
        runs = index.runs(family)
        error = fresh_error(family, runs)
        again = share(runs, successes(runs, "fresh"))
        told = again if error is None else f"{again}, off by {number(error, 2)} {unit(family)}"
        rows.append([NAMES[family], MEASURES["fresh"], MISSING, MISSING, MISSING, told])
        for measure, name in PAPERS.items():
            theirs = printed(paper_counts(family, measure)), str(paper_recount(family, measure))
            alike = str(recount(family, runs, measure) or MISSING)
            rows.append([NAMES[family], name, *theirs, alike, share(runs, successes(runs, measure))])
    note = (
        "Recounted: from the one blend that tables 11 to 18 list for a pair, the paper's and ours. The paper's counts "
        f"of mid-task are met exactly if that blend has to come within {100 * REACHED:g} % of the distance, whatever "
        "its β."
    )
    columns = ("family", "measure", "paper", "paper, recounted", "ours, recounted", "ours")
    return [Table(INTERPOLATED, columns, rows), note]


def share(runs: Sequence[Run], counted: Count | None) -> str:
    """Formats a count with its number of seeds, or the reason it is missing."""
    return f"{counted} ({seeds(counted.seeds)})" if counted else lack(runs)


def episode_ends(index: RunIndex) -> list[Block]:
    """Returns table 7."""
    ((which, trajectories),) = numbers()["table-7"]["panels"].items()
    paper = [printed(steps) for _, steps in trajectories]
    rows = [[f"paper, {which}", *paper]]
    for run in index.runs(ANT, "ear", "+no-noise"):
        for evaluation in run.of_seed("evaluation", "seeds"):
            same = next(task for task in evaluation["tasks"] if which.startswith(f"{task['name']},"))
            worst = min(evaluation["tasks"], key=lambda task: sum(task["episodes"]["length"]))
            for task in {task["name"]: task for task in (same, worst)}.values():
                lengths = [count(length) for length in task["episodes"]["length"]][: len(paper)]
                missing = [MISSING] * (len(paper) - len(lengths))
                rows.append([f"ours, {task['name']}, seed {run.seed}", *lengths, *missing])
    if len(rows) == 1:
        rows.append(["ours", lack(index.runs(ANT, "ear", "+no-noise")), *[MISSING] * (len(paper) - 1)])
    caption = "Length in steps of episodes of Ant-Dir. Ours: the paper's task, and the task with the shortest episodes."
    return [Table(caption, ("trajectory", *map(str, range(1, len(paper) + 1))), rows)]


def failures(index: RunIndex) -> list[Block]:
    """Returns table 8."""
    rows = []
    for (policy, paper), variant in zip(numbers()["table-8"]["panels"][""], ("+no-noise", ""), strict=True):
        runs = index.runs(ANT, "ear", variant)
        rows.append([policy, printed(paper), share(runs, failed_tasks(runs))])
    caption = f"Tasks of Ant-Dir in which at least one of the first {FIRST} episodes ends early."
    return [Table(caption, ("policy", "paper", "ours"), rows)]


def normalisation(index: RunIndex) -> list[Block]:
    """Returns table 9."""
    rows = []
    for line, variant in zip(numbers()["table-9"]["panels"][""], ("+no-norm", ""), strict=True):
        runs = index.runs(ANT, "ear", variant)
        again, met, between = (share(runs, successes(runs, measure)) for measure in MEASURES)
        rows.append([line[0], printed(line[1]), met, again, printed(line[2]), between])
    columns = ("policy", "mid-task, paper", "mid-task, ours", "again, ours", "1:1, paper", "1:1, ours")
    return [Table("Pairs of neighbouring tasks of Ant-Dir between which interpolation succeeds.", columns, rows)]
