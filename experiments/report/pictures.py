"""Which of our runs each of the paper's figures shows, and the pictures of them."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from ear_jax.figures.compose import draw_compose
from ear_jax.figures.lse import draw_lse
from ear_jax.figures.map import draw_map
from experiments.paper import CHEETAH, COMPOSED, COMPOSED_STILLS, EXPERIMENTS, RUN_JUMP, STILLS, Analysis
from experiments.report.blocks import Block, Picture, Table
from experiments.report.figures import Lines, adaptation_curves, draw_panels, task_curves, training_curves
from experiments.report.formatting import NAMES, label, number
from experiments.report.measures import paper_return
from experiments.report.run_index import Run, RunIndex

FOLDER = "figures"


def _panels(id: str, found: RunIndex, has: Callable[[Run], Any]) -> dict[str, Lines]:
    """A figure's lines by family, of the runs that have what it shows; nothing without a run is there."""
    panels: dict[str, Lines] = {}
    for method in EXPERIMENTS[id].methods:
        runs = [run for run in found.of(method) if has(run)]
        if runs:
            panels.setdefault(method.family, {})[label(method)] = runs
    return panels


def training(id: str, found: RunIndex, out: Path) -> list[Block]:
    """Figures 2, 8, 10, 12 and 13."""
    panels = _panels(id, found, lambda run: run.rows)
    if not panels:
        return []
    draws = []
    for family, lines in panels.items():
        paper = paper_return(family, "ear")
        reference = ("paper's EAR-SAC at its end", paper["mean"]) if paper else None
        draws.append(partial(training_curves, title=NAMES[family], lines=lines, reference=reference))
    draw_panels(out / FOLDER / f"{id}.png", draws)
    caption = (
        "Return, mean over training tasks, in evaluations during training; the dotted line is the paper's table 1. "
        "With several seeds: their mean amid the standard deviation."
    )
    return [Picture(f"{FOLDER}/{id}.png", caption)]


def adaptation(id: str, found: RunIndex, out: Path) -> list[Block]:
    """Figures 5, 11 and 14."""
    panels = _panels(id, found, lambda run: any(task["epochs"] for task in run.of_seed("adaptation", "tasks")))
    if not panels:
        return []
    draws = [partial(adaptation_curves, title=NAMES[family], lines=lines) for family, lines in panels.items()]
    draw_panels(out / FOLDER / f"{id}.png", draws)
    caption = (
        "Adaptation to unseen tasks. EAR-SAC and OHE-SAC search a code by the cross-entropy method, 90 noisy episodes "
        "an epoch; PEARL infers it from one more episode each time; MAML tunes it by gradient steps, 20 episodes each. "
        "Solid: what was found, on fresh episodes; dashed: the episodes it was found from, of a search the best one, "
        "which the paper shows; star: a code taken from a map that serves all tasks together."
    )
    return [Picture(f"{FOLDER}/{id}.png", caption), *_answers(panels)]


def _answers(panels: dict[str, Lines]) -> list[Block]:
    """What codes taken from a map achieve on unseen tasks, a row a task."""
    rows = [
        [f"{NAMES[family]}, {label}, seed {run.seed}", *_answer(task)]
        for family, lines in panels.items()
        for label, runs in lines.items()
        for run in runs
        for task in run.of_seed("adaptation", "tasks")
        if task["target"] is not None and task.get("zero_shot")
    ]
    columns = ("run", "target", "achieved", "error", "return", "return after 3 epochs of search")
    caption = "Unseen tasks answered from a map of 500 episodes, which serves all of them, without search (m/s or °)."
    return [Table(caption, columns, rows)] if rows else []


def _answer(task: dict[str, Any]) -> list[str]:
    answer, epochs = task["zero_shot"], task["epochs"]
    third = number(epochs[min(2, len(epochs) - 1)]["reevaluated"])
    values = (task["target"], answer["achieved"], answer["error"])
    return [*(number(value, 2) for value in values), number(answer["reevaluated"]), third]


def each_task(id: str, found: RunIndex, out: Path) -> list[Block]:
    """Figure 9."""
    blocks: list[Block] = []
    for run in found.runs(CHEETAH):
        file = f"{FOLDER}/{id}-seed{run.seed}.png"
        draw_panels(out / file, [partial(task_curves, title=f"{NAMES[CHEETAH]}, seed {run.seed}", run=run)])
        blocks.append(Picture(file, f"Return of each commanded speed during training, seed {run.seed}."))
    return blocks


def _drawn(runs: list[Run], name: str, caption: str, draw: Callable[[Path, Any], list[Path]], out: Path) -> list[Block]:
    """Pictures of an analysis of each run, by the function that the `ear` command draws them with."""
    blocks: list[Block] = []
    for run in runs:
        document = run.document(name)
        if document:
            (out / FOLDER).mkdir(parents=True, exist_ok=True)
            mine = {**document, "seeds": run.of_seed(name, "seeds")}
            files = draw(out / FOLDER, mine)
            blocks += [Picture(f"{FOLDER}/{path.name}", f"{caption}, seed {run.seed}.") for path in files]
    return blocks


def stills(id: str, found: RunIndex, out: Path) -> list[Block]:
    """Figure 3."""
    strips = _strips(found.runs(CHEETAH), STILLS, out)
    return [*strips, "The paper looked for β that meet 1.2, 1.5 and 1.7 m/s; ours are fixed."] if strips else []


def _strips(runs: list[Run], analysis: Analysis, out: Path) -> list[Block]:
    """The pictures that records keep, with what is seen on them."""
    blocks: list[Block] = []
    for run in runs:
        document, kept = run.document(analysis.name), run.place / f"{analysis.name}.png"
        if document and kept.is_file():
            (out / FOLDER).mkdir(parents=True, exist_ok=True)
            file = f"{FOLDER}/{run.name}-{kept.name}"
            shutil.copyfile(kept, out / file)
            blocks.append(Picture(file, f"{_seen(document)}, seed {run.seed}."))
    return blocks


def _seen(document: dict[str, Any]) -> str:
    """A strip in words, from its top row to its last."""
    unit = document["commanded"]["unit"]
    scenes = (f"{scene['name']} {number(scene['outcome'], 2)} {unit}" for scene in document["scenes"])
    return f"{document['scenes'][0]['steps']} steps from one start: {', '.join(scenes)}"


def composed(id: str, found: RunIndex, out: Path) -> list[Block]:
    """Figure 4."""
    caption = "Outcomes along β, means over the second half of the roll-out, and which feet are down"
    runs = found.runs(RUN_JUMP)
    strips = [block for one in COMPOSED_STILLS for block in _strips(runs, one, out)]
    return strips + [block for one in COMPOSED for block in _drawn(runs, one.name, caption, draw_compose, out)]


def sensory(id: str, found: RunIndex, out: Path) -> list[Block]:
    """Figure 6."""
    caption = (
        "Raw state and latent state embedding along a gait in their main directions, and their autocorrelations, at "
        "the environment's own step (the paper shortens it)"
    )
    return _drawn(found.runs(CHEETAH), "lse", caption, draw_lse, out)


def sphere(id: str, found: RunIndex, out: Path) -> list[Block]:
    """Figure 7."""
    caption = "The sphere of LTEs, coloured by the speed each place gives (m/s); circles: training tasks"
    return _drawn(found.runs(CHEETAH), "map", caption, draw_map, out)
