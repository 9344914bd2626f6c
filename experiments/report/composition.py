"""Table 10, composition: blends of two motions, and running and jumping at once."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from experiments.paper import BOTH, COMPOSITIONS, FRONT, RUN_JUMP, WALK_STAND, numbers
from experiments.report.blocks import Block, Table
from experiments.report.formatting import VARIANTS, lack, number, percent, printed
from experiments.report.run_index import Run, RunIndex

PAPERS_BETA = (
    "The paper's β of each composition. Move-jumping, backward jumps with a raised hind leg, is what one of its seeds "
    "did in place of run-jumping."
)
RUNNING = 1.0  # m/s backward, from which on a blend runs


class Motion(NamedTuple):
    """The mean motion under a blend, or under an LTE."""

    speed: float  # backward, m/s
    height: float  # of the hind foot, m


class Raised(NamedTuple):
    """Motions faster backward than `RUNNING`, and those of them with a raised hind foot."""

    mean: float  # height of the hind foot in the two ends' mean, m; higher is raised
    running: dict[Any, Motion]  # by β, or by the number of an LTE
    both: dict[Any, Motion]


def raised_blends(blends: Sequence[dict[str, Any]]) -> Raised:
    """Finds the blends between two tasks that run with a raised hind foot, by β."""
    motions = motions_along_beta(blends)
    mean = (motions[1].height + motions[0].height) / 2
    return _raised({beta: motion for beta, motion in motions.items() if 0 < beta < 1}, mean)


def raised_ltes(traded: dict[str, Any]) -> Raised:
    """Finds the LTEs of a front that run with a raised hind foot; its ends are `back-7` and `jump-10`."""
    ends = [task["rewards"][1] for task in traded["trained"] if task["name"] in ("back-7", "jump-10")]
    return _raised(dict(enumerate(Motion(*rewards) for rewards in traded["rewards"])), float(np.mean(ends)))


def motions_along_beta(blends: Sequence[dict[str, Any]]) -> dict[float, Motion]:
    """Returns what each blend of a composition does, by β."""
    return {blend["beta"]: Motion(-blend["outcome"]["velocity"], blend["outcome"]["height"]) for blend in blends}


def _raised(motions: Mapping[Any, Motion], mean: float) -> Raised:
    running = {name: motion for name, motion in motions.items() if motion.speed > RUNNING}
    return Raised(mean, running, {name: motion for name, motion in running.items() if motion.height > mean})


def composition(index: RunIndex) -> list[Block]:
    """Returns table 10: the β of the paper, and the outcomes of our blends along β."""
    panels = numbers()["table-10"]["panels"]
    chosen = [[name, *(printed(cell) for cell in row)] for name, rows in panels.items() for row in rows]
    blocks: list[Block] = [Table(PAPERS_BETA, ("seed", "composition", "β"), chosen)]
    runs = {variant: index.runs(RUN_JUMP, variant=variant) for variant in ("", BOTH)}
    for variant, several in runs.items():
        for run, analysis in product(several, COMPOSITIONS):
            for composed in run.of_seed(analysis.name, "seeds"):
                seed = f"seed {run.seed}{VARIANTS[variant]}"
                blocks.append(_along_beta(seed, run.document(analysis.name) or {}, composed["blends"]))
                blocks += [] if analysis == WALK_STAND else [_told(composed["blends"])]
    if len(blocks) == 1:
        blocks.append(f"Ours: {lack(runs[''])}.")
    return [*blocks, *_over_the_sphere(runs)]


def _over_the_sphere(runs: Mapping[str, list[Run]]) -> Iterator[Block]:
    """Tells how many LTEs all over the sphere run with the hind foot raised, and how high at best.

    Args:
      runs: by variant.
    """
    for variant, run in ((variant, run) for variant, several in runs.items() for run in several):
        for traded in run.of_seed(FRONT.name, "seeds"):
            found = raised_ltes(traded)
            highest = max((motion.height for motion in found.running.values()), default=0.0)
            yield (
                f"Seed {run.seed}{VARIANTS[variant]}: of {len(traded['rewards']):,} LTEs, {len(found.running):,} run "
                f"backward faster than {RUNNING:g} m/s. Of these, {len(found.both) or 'none'} hold the hind foot "
                f"higher than {number(found.mean, 2)} m, the mean of run and jump; at best it is at "
                f"{number(highest, 2)} m."
            )


def _told(blends: Sequence[dict[str, Any]]) -> str:
    """Tells which blends between two tasks run with the hind foot higher than the mean of the two."""
    found = raised_blends(blends)
    height = f"{number(found.mean, 2)} m, the mean of the two ends"
    wanted = f"faster than {RUNNING:g} m/s with the hind foot higher than {height}"
    if not found.both:
        return f"No blend between them runs backward {wanted}."
    each = (
        f"β = {beta:g} ({number(motion.speed, 2)} m/s at {number(motion.height, 2)} m)"
        for beta, motion in found.both.items()
    )
    end = motions_along_beta(blends)[0].speed
    return f"Backward {wanted}: {', '.join(each)}. The end at β = 0 runs at {number(end, 2)} m/s by itself."


def _along_beta(seed: str, document: dict[str, Any], blends: list[dict[str, Any]]) -> Table:
    first, second = document["between"]
    feet = document["feet"]
    rows = [
        [
            printed(blend["beta"]),
            number(blend["outcome"]["velocity"], 2),
            number(blend["outcome"]["height"], 2),
            *(percent(blend["contact"][foot], 0) for foot in feet),
            percent(blend["airborne"], 0),
        ]
        for blend in blends
    ]
    ends = f"{first} (β = 1) to {second} (β = 0)"
    caption = f"Ours, {seed}: {ends}, {document['steps']} steps; means over the second half."
    down = tuple(f"{foot} foot down" for foot in feet)
    return Table(caption, ("β", "velocity (m/s)", "height (m)", *down, "no foot down"), rows)
