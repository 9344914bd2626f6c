"""The paper's tables and figures by number, and our own, each with the runs it needs. Data; imports no JAX.

`paper.json` holds the numbers of the paper's tables: for each id the columns, and the rows of each panel (a seed, or a
pair of tasks). The paper's figures are curves and pictures without numbers; its figure 1 is a diagram and needs no run.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

NUMBERS = Path(__file__).with_name("paper.json")


@dataclass(frozen=True)
class Analysis:
    """An `ear` command on a trained run, whose JSON document is recorded under a name."""

    name: str
    command: str
    options: tuple[str, ...] = ()
    picture: str = ""  # key of the file in the document that is recorded with it
    writes: str = ""  # name of the policy's file that the command writes into the record
    of: str = ""  # name of such a file that the command is run on, instead of the run


@dataclass(frozen=True)
class Method:
    """A method trained on one family, once for each seed, with the analyses to follow."""

    family: str
    agent: str
    variant: str  # suffix of the preset's name, as in +no-noise
    analyses: tuple[Analysis, ...]
    seeds: int | None = None  # the experiment's by default


@dataclass(frozen=True)
class Experiment:
    """One table or figure."""

    id: str
    shows: str
    methods: tuple[Method, ...] = ()  # none: the table lists settings
    seeds: int = 3  # the paper's


def methods(
    families: tuple[str, ...],
    *analyses: Analysis,
    agents: tuple[str, ...] = ("ear",),
    variants: tuple[str, ...] = ("",),
    seeds: int | None = None,
) -> tuple[Method, ...]:
    """Returns every agent and variant on every family."""
    return tuple(
        Method(*names, tuple(on(names[0], one) for one in analyses), seeds)
        for names in product(families, agents, variants)
    )


def on(family: str, analysis: Analysis) -> Analysis:
    """Returns an analysis with the options that it has for a family."""
    return replace(analysis, options=OPTIONS.get((family, analysis.command), analysis.options))


def episodes(family: str) -> int:
    """Returns the episodes of each task in an evaluation."""
    return int(on(family, EVALUATION).options[-1])


def between(kind: str, first: str, second: str, *options: str) -> Analysis:
    """Returns the analysis of a blend of two tasks, named KIND-FIRST-SECOND."""
    command = "compose" if kind == "composition" else "interpolate"
    return Analysis(f"{kind}-{first}-{second}", command, ("--between", first, second, *options))


def stills(name: str, first: str, second: str, *options: str) -> Analysis:
    """Returns the analysis that draws poses along roll-outs of two tasks and of their blends."""
    return Analysis(name, "render", ("--interpolate", first, second, *options, "--no-film"), picture="strip")


def numbers() -> dict[str, Any]:
    """Returns the paper's tables by id: `columns`, and `panels`, lists of rows by name."""
    return json.loads(NUMBERS.read_text())


CHEETAH, ANT, HOPPER, WALKER = FAMILIES = ("halfcheetah-vel", "ant-dir", "hopper-vel", "walker-vel")
RUN_JUMP, REACH = "halfcheetah-run-jump", "reach"
OFF_POLICY = ("ear", "pearl", "multihead", "onehot")
WIDE, GATHERED, CATEGORICAL, EQUIVARIANT, BOTH = "+wide", "+gathered", "+categorical", "+equivariant", "+both"
TURNED = ("", EQUIVARIANT)
EAR_VARIANTS = (*TURNED, CATEGORICAL, WIDE, GATHERED, "+no-noise", "+no-norm", "+no-noise+no-norm")

EVALUATION = Analysis("evaluation", "evaluate", ("--episodes", "5"))
INTERPOLATION = Analysis("interpolation", "interpolate", ("--all-pairs",))
ADAPTATION = Analysis("adaptation", "adapt")
REFINED = "refined.safetensors"
REFINEMENT = Analysis("refinement", "refine", writes=REFINED)
REFINED_EVALUATION = replace(EVALUATION, name="refined-evaluation", of=REFINED)
REFINED_INTERPOLATION = replace(INTERPOLATION, name="refined-interpolation", of=REFINED)
# By family. An ant's returns scatter; one episode of a task teaches those that are symmetric to it; and without the
# penalty on lateral speed, which the paper's text has, an ant runs aside of its direction where it is faster there.
OPTIONS = {
    (ANT, "evaluate"): ("--episodes", "20"),
    (ANT, "refine"): ("--iterations", "800", "--iteration-episodes", "48", "--env.lateral-weight", "1"),
    (CHEETAH, "refine"): ("--iterations", "1500"),
}
REFINING = (EVALUATION, INTERPOLATION, REFINEMENT, REFINED_EVALUATION, REFINED_INTERPOLATION)
MAP = Analysis("map", "map")
SENSORY = Analysis("lse", "lse")
STILLS = stills("stills", "1", "2")
BETAS = ("--beta", "1.8", "1.5", "1.2", "-0.2", "-0.5", "-0.8")
MET = tuple(between(f"at-{target}", "2", "3", "--target", target) for target in ("2.2", "2.5", "2.7"))
SPEEDS_BEYOND = tuple(between("extrapolation", *pair, *BETAS) for pair in (("1", "2"), ("4", "5"), ("9", "10")))
DIRECTIONS_BEYOND = tuple(
    between("extrapolation", *pair, *BETAS) for pair in (("0", "15"), ("120", "135"), ("270", "285"))
)
# The paper's two, and one for `fast+both`, whose blends run with the hind foot raised.
_PAIRS = (("walk", "stand"), ("run", "jump"), ("back-5", "jump-5"))
COMPOSITIONS = WALK_STAND, RUN_JUMPING, BACK_JUMPING = tuple(
    between("composition", *pair, "--steps", "1000") for pair in _PAIRS
)
COMPOSED = (WALK_STAND, RUN_JUMPING)
FRONT = Analysis("front", "front", ("--reward", "-velocity", "height"))
COMPOSITION_STILLS = *COMPOSED_STILLS, BACK_JUMPING_STILLS = tuple(
    stills(f"stills-{first}-{second}", first, second, "--beta", "0.7", "0.6", "0.5", "0.4") for first, second in _PAIRS
)

TABLES = (
    Experiment(
        "table-1",
        "final returns of all methods",
        methods((CHEETAH, HOPPER, WALKER), EVALUATION, seeds=5)
        + methods((ANT,), EVALUATION)
        + methods((ANT,), EVALUATION, variants=(EQUIVARIANT,), seeds=5)
        + methods(FAMILIES, EVALUATION, agents=("pearl", "multihead"))
        + methods((ANT,), EVALUATION, agents=("multihead",), variants=(EQUIVARIANT,))
        + methods(FAMILIES, EVALUATION, agents=("onehot", "maml", "onehot-blind")),
    ),
    Experiment("table-2", "hyperparameters"),
    Experiment("table-3", "training tasks of each method"),
    Experiment("table-4", "2 and 3 m/s interpolated", methods((CHEETAH,), EVALUATION, *MET)),
    Experiment("table-5", "success of interpolation", methods(FAMILIES, INTERPOLATION)),
    Experiment("table-6", "extrapolation", methods((CHEETAH,), *SPEEDS_BEYOND) + methods((ANT,), *DIRECTIONS_BEYOND)),
    Experiment("table-7", "length of episodes without LTE noise", methods((ANT,), EVALUATION, variants=("+no-noise",))),
    Experiment("table-8", "failures without LTE noise", methods((ANT,), EVALUATION, variants=("", "+no-noise"))),
    Experiment(
        "table-9", "interpolation without normalisation", methods((ANT,), INTERPOLATION, variants=("", "+no-norm"))
    ),
    Experiment(
        "table-10",
        "composition",
        methods((RUN_JUMP,), EVALUATION, *COMPOSED, FRONT)
        + methods((RUN_JUMP,), EVALUATION, *COMPOSITIONS, FRONT, variants=(BOTH,), seeds=1),
    ),
    Experiment("table-11", "mid-task interpolation, HalfCheetah-Vel", methods((CHEETAH,), INTERPOLATION)),
    Experiment("table-12", "mid-task interpolation, Hopper-Vel", methods((HOPPER,), INTERPOLATION)),
    Experiment("table-13", "mid-task interpolation, Walker-Vel", methods((WALKER,), INTERPOLATION)),
    Experiment("table-14", "mid-task interpolation, Ant-Dir", methods((ANT,), INTERPOLATION)),
    Experiment("table-15", "1:1 interpolation, HalfCheetah-Vel", methods((CHEETAH,), INTERPOLATION)),
    Experiment("table-16", "1:1 interpolation, Hopper-Vel", methods((HOPPER,), INTERPOLATION)),
    Experiment("table-17", "1:1 interpolation, Walker-Vel", methods((WALKER,), INTERPOLATION)),
    Experiment("table-18", "1:1 interpolation, Ant-Dir", methods((ANT,), INTERPOLATION)),
)
FIGURES = (
    Experiment("figure-2", "returns during training", methods(FAMILIES, agents=OFF_POLICY)),
    Experiment("figure-3", "stills of interpolated running", methods((CHEETAH,), STILLS), seeds=1),
    Experiment(
        "figure-4",
        "stills of composed motions",
        methods((RUN_JUMP,), *COMPOSED, *COMPOSED_STILLS, FRONT)
        + methods((RUN_JUMP,), BACK_JUMPING, BACK_JUMPING_STILLS, FRONT, variants=(BOTH,)),
        seeds=1,
    ),
    Experiment(
        "figure-5",
        "adaptation to unseen tasks",
        methods(FAMILIES, ADAPTATION, agents=("ear", "onehot", "pearl", "maml")),
    ),
    Experiment("figure-6", "LSEs beside raw states", methods((CHEETAH,), SENSORY), seeds=1),
    Experiment("figure-7", "the sphere of LTEs", methods((CHEETAH,), MAP), seeds=1),
    Experiment("figure-8", "MLP and RNN", methods((CHEETAH,), agents=("ear", "ear-rnn"))),
    Experiment("figure-9", "returns of each speed during training", methods((CHEETAH,))),
    Experiment("figure-10", "Metaworld-Reach: returns during training", methods((REACH,), agents=OFF_POLICY)),
    Experiment("figure-11", "Metaworld-Reach: adaptation", methods((REACH,), ADAPTATION, agents=("ear", "pearl"))),
    Experiment("figure-12", "training without LTE noise", methods((ANT,), variants=("", "+no-noise"))),
    Experiment("figure-13", "training without normalisation", methods((ANT,), variants=("", "+no-norm"))),
    Experiment("figure-14", "adaptation without normalisation", methods((ANT,), ADAPTATION, variants=("", "+no-norm"))),
)
OURS = (
    Experiment(
        "agents",
        "agents and ablations on HalfCheetah-Vel",
        methods((CHEETAH,), EVALUATION, agents=("ear", "onehot", "onehot-blind", "multihead", "ear-rnn", "pearl"))
        + methods((CHEETAH,), EVALUATION, INTERPOLATION, variants=("+no-noise", "+no-norm", "+no-noise+no-norm")),
        seeds=2,
    ),
    Experiment(
        "wide",
        "EAR with networks twice as wide",
        methods(FAMILIES, EVALUATION, INTERPOLATION, ADAPTATION, variants=("", WIDE)),
    ),
    Experiment(
        "gathered",
        "EAR with LTEs gathered at the start",
        methods(FAMILIES, EVALUATION, INTERPOLATION, ADAPTATION, variants=("", GATHERED)),
    ),
    Experiment(
        "categorical",
        "EAR with residual categorical critics",
        methods(FAMILIES, EVALUATION, INTERPOLATION, ADAPTATION, variants=("", CATEGORICAL)),
    ),
    Experiment(
        "equivariant",
        "EAR that turns with the ant",
        methods((ANT,), EVALUATION, INTERPOLATION, ADAPTATION, variants=TURNED),
    ),
    Experiment(
        "refined",
        "EAR and MHMT refined by PPO",
        methods((CHEETAH, HOPPER, WALKER), *REFINING)
        + methods((ANT,), *REFINING, variants=(EQUIVARIANT,))
        + methods(FAMILIES, EVALUATION, REFINEMENT, REFINED_EVALUATION, agents=("multihead",))
        + methods((ANT,), EVALUATION, REFINEMENT, REFINED_EVALUATION, agents=("multihead",), variants=(EQUIVARIANT,)),
    ),
    Experiment("space", "how good EAR's spaces of LTEs are"),
    Experiment(
        "reach",
        "Metaworld-Reach: returns, and goals between goals",
        methods((REACH,), EVALUATION, INTERPOLATION)
        + methods((REACH,), EVALUATION, agents=("pearl", "multihead", "onehot")),
    ),
)
EXPERIMENTS = {experiment.id: experiment for experiment in (*TABLES, *FIGURES, *OURS)}
