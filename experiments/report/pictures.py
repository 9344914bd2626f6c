"""The paper's figures, drawn from our runs."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from ear_jax.embeddings.map import PLACES
from ear_jax.embeddings.search import Search
from ear_jax.figures.compose import draw_compose
from ear_jax.figures.front import draw_front
from ear_jax.figures.lse import draw_lse
from ear_jax.figures.map import draw_map
from ear_jax.files.replacing import copy_file, folder
from ear_jax.presets import preset_config
from experiments.paper import (
    BOTH,
    CHEETAH,
    COMPOSITION_STILLS,
    COMPOSITIONS,
    EXPERIMENTS,
    FRONT,
    RUN_JUMP,
    STILLS,
    Analysis,
)
from experiments.report.blocks import Block, Picture, Table
from experiments.report.figures import Lines, adaptation_curves, draw_panels, task_curves, training_curves
from experiments.report.formatting import NAMES, VARIANTS, label, number
from experiments.report.measures import paper_return
from experiments.report.run_index import Run, RunIndex

FOLDER = "figures"


def _panels(id: str, index: RunIndex, has: Callable[[Run], Any]) -> dict[str, Lines]:
    """Returns a figure's lines by family. Runs that lack its data are left out, and families without a run."""
    panels: dict[str, Lines] = {}
    for method in EXPERIMENTS[id].methods:
        panels.setdefault(method.family, {})[label(method)] = [run for run in index.of(method) if has(run)]
    return {family: lines for family, lines in panels.items() if any(lines.values())}


def training(id: str, index: RunIndex, out: Path) -> list[Block]:
    """Returns figure 2, 8, 10, 12 or 13."""
    panels = _panels(id, index, lambda run: run.rows)
    if not panels:
        return []
    draws = []
    for family, lines in panels.items():
        paper = paper_return(family, "ear")
        reference = ("paper's final EAR-SAC", paper["mean"]) if paper else None
        draws.append(partial(training_curves, title=NAMES[family], lines=lines, reference=reference))
    draw_panels(out / FOLDER / f"{id}.png", draws)
    caption = (
        "Mean return over the training tasks, evaluated during training. With several seeds: mean ± standard "
        "deviation. The dotted line is the paper's table 1."
    )
    return [Picture(f"{FOLDER}/{id}.png", caption)]


def adaptation(id: str, index: RunIndex, out: Path) -> list[Block]:
    """Returns figure 5, 11 or 14."""
    panels = _panels(id, index, lambda run: any(task["epochs"] for task in run.of_seed("adaptation", "tasks")))
    if not panels:
        return []
    draws = [partial(adaptation_curves, title=NAMES[family], lines=lines) for family, lines in panels.items()]
    tuned = preset_config(CHEETAH, index.preset.split("+")[0], "maml").collect.envs
    draw_panels(out / FOLDER / f"{id}.png", draws)
    caption = (
        "Adaptation to unseen tasks. EAR-SAC and OHE-SAC search an LTE by the cross-entropy method, "
        f"{Search().candidates} noisy episodes an epoch. PEARL infers it from one more episode each time. MAML tunes "
        f"by gradient steps of {tuned} episodes each. Solid: the result on fresh episodes. Dashed: the episodes of the "
        "search itself, the best one of each epoch, which is the paper's curve. Star: an LTE read off a map that "
        "serves all tasks."
    )
    return [Picture(f"{FOLDER}/{id}.png", caption), *_answers(panels)]


def _answers(panels: dict[str, Lines]) -> list[Block]:
    """Returns a table of unseen tasks whose LTEs were read off a map, a row for each task."""
    rows = [
        [f"{NAMES[family]}, {label}, seed {run.seed}", *_answer(task)]
        for family, lines in panels.items()
        for label, runs in lines.items()
        for run in runs
        for task in run.of_seed("adaptation", "tasks")
        if task["target"] is not None and task.get("zero_shot")
    ]
    columns = ("run", "target", "achieved", "error", "return", "return after 3 epochs of search")
    caption = (
        f"Unseen tasks without search: LTEs read off one map of {PLACES} episodes, which serves all tasks (m/s or °)."
    )
    return [Table(caption, columns, rows)] if rows else []


def _answer(task: dict[str, Any]) -> list[str]:
    answer, epochs = task["zero_shot"], task["epochs"]
    third = number(epochs[min(2, len(epochs) - 1)]["reevaluated"])
    values = (task["target"], answer["achieved"], answer["error"])
    return [*(number(value, 2) for value in values), number(answer["reevaluated"]), third]


def each_task(id: str, index: RunIndex, out: Path) -> list[Block]:
    """Returns figure 9."""
    blocks: list[Block] = []
    for run in index.runs(CHEETAH):
        file = f"{FOLDER}/{id}-seed{run.seed}.png"
        draw_panels(out / file, [partial(task_curves, title=f"{NAMES[CHEETAH]}, seed {run.seed}", run=run)])
        blocks.append(Picture(file, f"Return at each commanded speed during training, seed {run.seed}."))
    return blocks


def _drawn(runs: list[Run], name: str, caption: str, draw: Callable[[Path, Any], list[Path]], out: Path) -> list[Block]:
    """Draws the pictures of an analysis of each run, with the function that the `ear` command uses."""
    blocks: list[Block] = []
    for run in runs:
        document = run.document(name)
        if document:
            drawings = folder(out / FOLDER / run.variant.replace("+", ""))
            of_this_seed = {**document, "seeds": run.of_seed(name, "seeds")}
            files = [path.relative_to(out).as_posix() for path in draw(drawings, of_this_seed)]
            blocks += [Picture(file, f"{caption}, seed {run.seed}{VARIANTS[run.variant]}.") for file in files]
    return blocks


def stills(id: str, index: RunIndex, out: Path) -> list[Block]:
    """Returns figure 3."""
    strips = _strips(index.runs(CHEETAH), STILLS, out)
    return [*strips, "The paper chose the β that meet 1.2, 1.5 and 1.7 m/s; our β are fixed."] if strips else []


def _strips(runs: list[Run], analysis: Analysis, out: Path) -> list[Block]:
    """Copies the strips that records keep, and captions them."""
    blocks: list[Block] = []
    for run in runs:
        document, kept = run.document(analysis.name), run.directory / f"{analysis.name}.png"
        if document and kept.is_file():
            folder(out / FOLDER)
            file = f"{FOLDER}/{run.name}-{kept.name}"
            copy_file(kept, out / file)
            blocks.append(Picture(file, f"{_describe(document)}, seed {run.seed}{VARIANTS[run.variant]}."))
    return blocks


def _describe(document: dict[str, Any]) -> str:
    """Describes a strip from its top row to its last."""
    unit = document["commanded"]["unit"]
    scenes = (f"{scene['name']} {number(scene['outcome'], 2)} {unit}" for scene in document["scenes"])
    return f"{document['scenes'][0]['steps']} steps from one start: {', '.join(scenes)}"


def composed(id: str, index: RunIndex, out: Path) -> list[Block]:
    """Returns figure 4."""
    caption = "Outcomes along β, means over the second half of the roll-out, and the feet on the ground"
    runs = [run for variant in ("", BOTH) for run in index.runs(RUN_JUMP, variant=variant)]
    strips = [block for analysis in COMPOSITION_STILLS for block in _strips(runs, analysis, out)]
    figures = [block for analysis in COMPOSITIONS for block in _drawn(runs, analysis.name, caption, draw_compose, out)]
    traded = "Backward speed (m/s) and height of the hind foot (m) under LTEs all over the sphere"
    return strips + figures + _drawn(runs, FRONT.name, traded, draw_front, out)


def sensory(id: str, index: RunIndex, out: Path) -> list[Block]:
    """Returns figure 6."""
    caption = (
        "Raw state and LSE along a gait in their principal components, with their autocorrelations, at the "
        "environment's own step (the paper shortens it)"
    )
    return _drawn(index.runs(CHEETAH), "lse", caption, draw_lse, out)


def sphere(id: str, index: RunIndex, out: Path) -> list[Block]:
    """Returns figure 7."""
    caption = "The sphere of LTEs, coloured by the speed that each LTE achieves (m/s); circles: training tasks"
    return _drawn(index.runs(CHEETAH), "map", caption, draw_map, out)
