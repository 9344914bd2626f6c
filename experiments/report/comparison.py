"""The comparison with the paper in words: where we are level, where short, and why.

Every number comes from the records or from `paper.json`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product

import numpy as np

from ear_jax.embeddings.interpolate import FRESH, REACHED
from ear_jax.envs.halfcheetah_vel import HalfCheetahVel
from experiments.paper import (
    ANT,
    CHEETAH,
    EQUIVARIANT,
    EVALUATION,
    EXPERIMENTS,
    FAMILIES,
    INTERPOLATION,
    REFINED_INTERPOLATION,
    TURNED,
    numbers,
)
from experiments.report.blocks import Points, Section
from experiments.report.claims import claims
from experiments.report.formatting import NAMES, VARIANTS, label, number, percent, printed, seeds, spread
from experiments.report.measures import (
    Count,
    failed_tasks,
    mean_return,
    paper_budget,
    paper_counts,
    paper_return,
    refinements,
    returns,
    successes,
    task_returns,
)
from experiments.report.run_index import Run, RunIndex

Verdict = tuple[int, str]  # 1 for above the paper, 0 for level with it, -1 for short of it; and the sentence on it
STANDINGS = {1: "Above the paper:", 0: "Level with the paper:", -1: "Short of the paper:"}
MEASURES = {"mid_task": "some blend meets the value midway", "one_to_one": "the blend at β = ½ lies between the two"}

WHY = (
    "LTE noise: the paper adds noise to the task embedding. The released code computes the noise and never uses it. "
    "Ours is in all of the actor's objectives.",
    "OHE-SAC: in the authors' older code (piao-0429/ear_tmp) the replay holds zeros in place of the one-hot. A policy "
    "that does not see its task returns about what the paper's row says. Ours sees its one-hot; `onehot-blind` is "
    "trained with zeros for comparison.",
    "Ant-Dir: the paper's text has a penalty on lateral speed and gives no weight; the released code's weight is 0. We "
    "use 0, except in `ear refine --env.lateral-weight 1`, by which ants are refined here. All returns are without it.",
    "Ant-Dir: `fast` also trains on transitions that are rotated by quarter turns and mirrored; the paper does not.",
    "Run-Jump: the paper rewards running backward and, in the jump tasks, the height of the hind leg (here: its foot); "
    "the released code rewards running forward and the height of the torso. We follow the paper.",
    "MHMT-SAC: the authors' older code ignores terminations for this agent alone. Here no agent bootstraps from them.",
    "MHMT-SAC on the hopper: it takes the lesser of its two critics. The mean of them, which EAR-SAC has there, makes "
    "MHMT-SAC overestimate; the recorded runs that use the mean belong to an earlier recipe.",
    "Metaworld-Reach: the paper gives neither its goals nor a return. Our ten goals lie on an ellipse in Meta-World's "
    "box of goals.",
    "Gradients: the released code clips those of the policy's three networks separately, ours together. The paper "
    "mentions no clipping.",
    "Policy that is evaluated: the released scripts load the best checkpoint of a run; ours is always the last.",
    "Task encoder: one linear layer, as in the paper's text; the released code has a hidden layer.",
    "Meeting the value midway: the paper does not define how near is near enough. We take "
    f"{100 * REACHED:g} % of the distance between the two tasks, which the counts of its table 5 bear out.",
)


def comparison(index: RunIndex) -> Section:
    """Returns the section; families without runs are listed as not compared yet."""
    verdicts = [*(verdict for family in FAMILIES for verdict in _verdicts(index, family)), *_baselines(index)]
    told = {title: [words for standing, words in verdicts if standing == wanted] for wanted, title in STANDINGS.items()}
    without = [NAMES[family] for family in FAMILIES if not index.runs(family)]
    return Section(
        "comparison",
        "Where we agree with the paper, where not, and why",
        [
            "A return is level with the paper if our mean is within one of the paper's standard deviations of the "
            "paper's mean. A share of pairs is level if it is at least the paper's. One seed is weak evidence; the "
            "paper has three. Where a baseline is short of the paper's, comparing it with EAR-SAC here says little.",
            *(block for title, points in told.items() for block in (title, Points(points or ["nothing"]))),
            *([f"Nothing to compare yet: {', '.join(without)}."] if without else []),
            *(["What the paper's comparisons show here:", Points(shown)] if (shown := claims(index)) else []),
            "Reasons, and differences from the paper or its code:",
            Points([*_budgets(index), *_cheetah(index), *_turned(index), *_onehot(index), *_tuned(index), *WHY]),
        ],
    )


def standing(values: Sequence[float], paper: dict[str, float]) -> int:
    """Compares the mean of returns with the paper's, of whose standard deviation one more or less is level."""
    difference = np.mean(values) - paper["mean"]
    return int(np.sign(difference)) if abs(difference) > paper["std"] else 0


def as_often(counted: Count, paper: dict[str, int]) -> int:
    """Returns 0 if at least as large a share of pairs succeeds as in the paper, and -1 otherwise."""
    return 0 if counted.number * paper["total"] >= paper["success"] * counted.total else -1


def _verdicts(index: RunIndex, family: str) -> Iterator[Verdict]:
    """Yields verdicts on EAR of a family, and on the one that turns with the robot."""
    for variant in TURNED:
        runs, name = index.runs(family, variant=variant), NAMES[family] + VARIANTS[variant]
        if runs:
            yield from _returned(name, runs)
            yield from _blended(family, name, runs)
            yield from _failed(name, runs) if family == ANT else ()


def _returned(name: str, runs: list[Run]) -> Iterator[Verdict]:
    """Yields verdicts on the returns of a method on a family, as trained and as refined, where the paper has it."""
    paper = paper_return(runs[0].config.family, runs[0].config.agent) if runs else None
    if paper:
        yield _return_verdict(f"{name}, return", [mean_return(run) for run in runs], paper)
        if refined := [entry["after"] for entry in refinements(runs)]:
            yield _return_verdict(f"{name}, return after `ear refine`", refined, paper)


def _blended(family: str, name: str, runs: list[Run]) -> Iterator[Verdict]:
    analyses = ((INTERPOLATION, ""), (REFINED_INTERPOLATION, " after `ear refine`"))
    for (analysis, when), (measure, words) in product(analyses, MEASURES.items()):
        counted, theirs = successes(runs, measure, analysis.name), paper_counts(family, measure)
        if counted and theirs:
            numbers_of_both = f"{counted} pairs ({seeds(counted.seeds)}); the paper {printed(theirs)}."
            again = successes(runs, "fresh", analysis.name) if measure == "mid_task" else None
            caveat = f" In {FRESH} fresh episodes the best of these blends meets it in {again}." if again else ""
            yield as_often(counted, theirs), f"{name}, {words}{when}: {numbers_of_both}{caveat}"


def _failed(name: str, runs: list[Run]) -> Iterator[Verdict]:
    counted, theirs = failed_tasks(runs), numbers()["table-8"]["panels"][""][1][1]
    if counted:
        as_seldom = counted.number * theirs["total"] <= theirs["failed"] * counted.total
        yield (
            0 if as_seldom else -1,
            f"{name}, tasks with an episode that ends early: {counted}; the paper {printed(theirs)}.",
        )


def _baselines(index: RunIndex) -> Iterator[Verdict]:
    """Yields verdicts on each other method that has runs and a row in the paper."""
    for method in EXPERIMENTS["table-1"].methods:
        if method.agent != "ear":
            yield from _returned(f"{NAMES[method.family]}, {label(method)}", index.of(method))


def _return_verdict(what: str, values: Sequence[float], paper: dict[str, float]) -> Verdict:
    return standing(values, paper), f"{what}: {spread(values)} ({seeds(values)}); the paper {printed(paper)}."


def _budgets(index: RunIndex) -> Iterator[str]:
    """Yields a sentence on our share of the paper's env steps and updates."""
    shares = []
    for family in FAMILIES:
        runs = index.runs(family)
        if runs:
            steps, updates = paper_budget(family)
            share_of_steps = np.mean([run.last["env_steps"] for run in runs]) / steps
            share_of_updates = np.mean([run.last["updates"] for run in runs]) / updates
            shares.append(
                f"{NAMES[family]} {percent(share_of_steps)} of the env steps and {percent(share_of_updates)} of the "
                "updates"
            )
    if shares:
        recipe = "" if index.preset == "paper" else f"`{index.preset}` is not the paper's recipe. "
        yield f"{recipe}Our share of the paper's training: {'; '.join(shares)}."


def _cheetah(index: RunIndex) -> Iterator[str]:
    """Yields the cheetah's cost of starting at rest, and the share of its two hardest tasks."""
    runs = index.runs(CHEETAH)
    if not runs:
        return
    losses = [loss for run in runs if (loss := _start_up_loss(run)) is not None]
    if losses:
        yield (
            "HalfCheetah-Vel: the cheetah starts at rest, and friction with the floor limits its acceleration. The "
            "first half of an episode therefore scores lower than the second, which costs at most "
            f"{number(-float(np.mean(losses)), 0)} of the {number(-np.mean([mean_return(run) for run in runs]))} "
            "points that we lose. The paper's policy cannot avoid all of it either."
        )
    tasks = {name: np.mean([task_returns(run)[name] for run in runs]) for name in task_returns(runs[0])}
    worst = sorted(tasks, key=lambda name: tasks[name])[:2]
    share = sum(tasks[name] for name in worst) / len(tasks)
    yield (
        f"HalfCheetah-Vel: the two tasks with the lowest return, {worst[0]} and {worst[1]}, contribute "
        f"{number(float(share))} to the mean return of {number(np.mean(list(tasks.values())))}."
    )


def _start_up_loss(run: Run) -> float | None:
    """Returns the return minus that of an episode whose two halves both score as the second one, averaged over tasks.

    It is approximate: the second half's mean speed is taken for each of its steps. None without an evaluation.
    """
    losses = []
    for evaluation in run.of_seed("evaluation", "seeds"):
        for task in evaluation["tasks"]:
            outcome, steps = task["outcome"], np.mean(task["episodes"]["length"])
            cost = HalfCheetahVel.control_cost * outcome["squared_action"]
            settled = -abs(outcome["velocity"] - task["target"]) - cost
            losses.append(task["return_mean"] - steps * settled)
    return float(np.mean(losses)) if losses else None


def _turned(index: RunIndex) -> Iterator[str]:
    """Yields the returns on Ant-Dir of methods that turn with the robot, beside those that do not."""
    ours = [
        f"{NAMES[agent]} {returns(turned)} instead of {returns(plain)}"
        for agent in ("ear", "multihead")
        if (plain := index.runs(ANT, agent)) and (turned := index.runs(ANT, agent, EQUIVARIANT))
    ]
    if ours:
        yield (
            "Ant-Dir: where the networks see one task in place of all that are symmetric to it, they learn 4 tasks "
            f"instead of 24. After half the updates the return is then higher: {', '.join(ours)}."
        )


def _onehot(index: RunIndex) -> Iterator[str]:
    """Yields the returns of OHE-SAC with its one-hot and with zeros in its place, beside the paper's row."""
    for family in FAMILIES:
        paper = paper_return(family, "onehot")
        ours = [
            f"{how} {returns(runs)}"
            for agent, how in (("onehot", "with its one-hot"), ("onehot-blind", "with the one-hot zeroed"))
            if (runs := index.runs(family, agent))
        ]
        if ours and paper:
            yield f"{NAMES[family]}: OHE-SAC {', '.join(ours)}; the paper's OHE-SAC {printed(paper)}."


def _tuned(index: RunIndex) -> Iterator[str]:
    """Yields what MAML gains by its gradient step, over the parameters that all tasks share."""
    for family in FAMILIES:
        evaluations = [one for run in index.runs(family, "maml") for one in run.of_seed(EVALUATION.name, "seeds")]
        pairs = [(one["untuned_return"], one["mean_return"]) for one in evaluations if "untuned_return" in one]
        if pairs:
            before, after = np.transpose(pairs)
            gain = number(np.mean(after - before))
            if len(pairs) > 1:
                error = np.std(after - before, ddof=1) / np.sqrt(len(pairs))
                gain += f" ± {number(error)} (standard error)"
            yield (
                f"{NAMES[family]}: MAML returns {spread(before)} with the parameters that all tasks share and "
                f"{spread(after)} after its gradient step in each: a gain of {gain}, {seeds(pairs)}."
            )
