"""Where we agree with the paper, where not, and why, in words; every number comes from records or `paper.json`."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from experiments.paper import ANT, CHEETAH, EXPERIMENTS, FAMILIES, numbers
from experiments.report.blocks import Points, Section
from experiments.report.formatting import NAMES, label, number, percent, printed, seeds
from experiments.report.measures import (
    failed_tasks,
    mean_return,
    paper_budget,
    paper_counts,
    paper_return,
    returns,
    successes,
    task_returns,
)
from experiments.report.run_index import Run, RunIndex

Verdict = tuple[bool, str]  # whether we agree, and what is compared
MEASURES = {"mid_task": "a β meets the value midway", "one_to_one": "β = ½ gives a value between"}

WHY = (
    "LTE noise: the paper adds noise to the task embedding; the released code computes it and never uses it. Ours has "
    "it in all of the actor's objectives.",
    "OHE-SAC: in the authors' code the replay holds zeros in place of the one-hot, so the paper's row is that of a "
    "policy that does not know its task. Ours sees its one-hot; `onehot-blind` is trained with zeros for comparison.",
    "Ant-Dir: the paper's text has a penalty on lateral speed of weight 1; the released code has 0, and so have we.",
    "Ant-Dir: `fast` trains on transitions turned by quarters and mirrored too; the paper does not.",
    "Run-Jump: the paper's jump is the height of the hind foot, running backward; the code has the torso, forward. "
    "We follow the paper.",
    "MHMT-SAC: the authors' code ignores terminations for this agent alone; here they end the value, as for all.",
    "Metaworld-Reach: the paper names neither its goals nor a number; our ten lie on an ellipse in Meta-World's box of "
    "goals.",
    "The policy's loss: the released code adds 0.001 times the mean squares of means and log standard deviations, and "
    "clips the gradients of its three networks apart; the paper has neither, and ours clips them together.",
    "Which policy: the released scripts play the best checkpoint of a run; ours is always its last.",
    "The task encoder is one linear layer, as the paper says; the code has a hidden layer.",
    "Reached, midway: the paper does not say how near is near enough; we take 5 % of the distance between the tasks.",
)


def comparison(found: RunIndex) -> Section:
    """The section; it says of each family without runs that there is nothing to compare yet."""
    told = [*(verdict for family in FAMILIES for verdict in _verdicts(found, family)), *_baselines(found)]
    agree, differ = ([words for agrees, words in told if agrees is wanted] for wanted in (True, False))
    without = [NAMES[family] for family in FAMILIES if not found.runs(family)]
    return Section(
        "comparison",
        "Where we agree with the paper, where not, and why",
        [
            "Level with the paper is a mean return no worse than the paper's mean less its standard deviation, and a "
            "share of pairs no smaller than the paper's. One seed tells little; the paper has three. A baseline that "
            "is short of the paper's says little of EAR-SAC beside it.",
            "Level with the paper:",
            Points(agree or ["nothing yet"]),
            "Short of the paper:",
            Points(differ or ["nothing"]),
            *([f"Nothing to compare yet: {', '.join(without)}."] if without else []),
            "What lies behind that, and what is done otherwise than in the paper or its code:",
            Points([*_budgets(found), *_cheetah(found), *_onehot(found), *WHY]),
        ],
    )


def _verdicts(found: RunIndex, family: str) -> Iterator[Verdict]:
    runs, paper = found.runs(family), paper_return(family, "ear")
    if not runs or not paper:
        return
    yield _return_verdict(NAMES[family], runs, paper)
    for what, words in MEASURES.items():
        counted, theirs = successes(runs, what), paper_counts(family, what)
        if counted:
            as_often = counted.number * theirs["total"] >= theirs["success"] * counted.total
            said = f"{counted} pairs ({seeds(counted.seeds)}); the paper {printed(theirs)}."
            yield as_often, f"{NAMES[family]}, {words}: {said}"
    failed = failed_tasks(runs) if family == ANT else None
    if failed:
        theirs = numbers()["table-8"]["panels"][""][1][1]
        as_seldom = failed.number * theirs["total"] <= theirs["failed"] * failed.total
        yield (
            as_seldom,
            f"{NAMES[family]}, tasks with an episode that ends early: {failed}; the paper {printed(theirs)}.",
        )


def _baselines(found: RunIndex) -> Iterator[Verdict]:
    """Other methods beside their rows in the paper."""
    for method in EXPERIMENTS["table-1"].methods:
        runs, paper = found.of(method), paper_return(method.family, method.agent)
        if method.agent != "ear" and runs and paper:
            yield _return_verdict(f"{NAMES[method.family]}, {label(method)}", runs, paper)


def _return_verdict(of: str, runs: list[Run], paper: dict[str, float]) -> Verdict:
    enough = bool(np.mean([mean_return(run) for run in runs]) >= paper["mean"] - paper["std"])
    return enough, f"{of}, return: {returns(runs)}; the paper {printed(paper)}."


def _budgets(found: RunIndex) -> Iterator[str]:
    """How much less than the paper's our runs trained."""
    shares = []
    for family in FAMILIES:
        runs = found.runs(family)
        if runs:
            steps, updates = paper_budget(family)
            part_of_steps = np.mean([run.last["env_steps"] for run in runs]) / steps
            part_of_updates = np.mean([run.last["updates"] for run in runs]) / updates
            shares.append(
                f"{NAMES[family]} {percent(part_of_steps)} of the env steps and {percent(part_of_updates)} of updates"
            )
    if shares:
        recipe = "" if found.preset == "paper" else f"`{found.preset}` is another recipe than the paper's. "
        yield f"{recipe}Of what the paper trained, ours had: {'; '.join(shares)}."


def _cheetah(found: RunIndex) -> Iterator[str]:
    """What starting up costs the cheetah, and its two hardest tasks."""
    runs = found.runs(CHEETAH)
    if not runs:
        return
    lost = [loss for run in runs if (loss := _start_up_loss(run)) is not None]
    if lost:
        yield (
            "The cheetah starts at rest and the floor's friction bounds how fast it speeds up: at most "
            f"{number(float(np.mean(lost)), 0)} of our return is what the first half of episodes scores below the "
            "second. No policy avoids all of that, and the paper's does not either."
        )
    tasks = {name: np.mean([task_returns(run)[name] for run in runs]) for name in task_returns(runs[0])}
    worst = sorted(tasks, key=lambda name: tasks[name])[:2]
    share = sum(tasks[name] for name in worst) / len(tasks)
    yield (
        f"Of our mean return on HalfCheetah-Vel, {number(np.mean(list(tasks.values())))}, the two lowest tasks, "
        f"{worst[0]} and {worst[1]}, make {number(float(share))}."
    )


def _start_up_loss(run: Run) -> float | None:
    """Return less that of an episode whose halves are both as its second one, the mean over tasks; about, as the
    second half's mean speed stands for each of its steps. None without an evaluation."""
    losses = []
    for one in run.of_seed("evaluation", "seeds"):
        for task in one["tasks"]:
            outcome, steps = task["outcome"], np.mean(task["episodes"]["length"])
            settled = -abs(outcome["velocity"] - task["target"]) - 0.1 * outcome["squared_action"]
            losses.append(task["return_mean"] - steps * settled)
    return float(np.mean(losses)) if losses else None


def _onehot(found: RunIndex) -> Iterator[str]:
    """What OHE-SAC reaches with its one-hot and without, beside the paper's row."""
    for family in FAMILIES:
        paper = paper_return(family, "onehot")
        ours = [
            f"{how} {returns(runs)}"
            for agent, how in (("onehot", "with its one-hot"), ("onehot-blind", "with the one-hot zeroed"))
            if (runs := found.runs(family, agent))
        ]
        if ours and paper:
            yield f"{NAMES[family]}: OHE-SAC {', '.join(ours)}; the paper's OHE-SAC {printed(paper)}."
