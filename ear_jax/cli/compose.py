"""`ear compose RUN`."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any

import tyro

from ear_jax.cli.arguments import check_betas, check_least, parse
from ear_jax.cli.on_run import OnRun
from ear_jax.cli.results import keep, label_of, print_table, show_and_keep
from ear_jax.errors import UsageError, counted
from ear_jax.process.terminal import phase

BETAS = tuple(round(0.1 * step, 1) for step in range(10, -1, -1))


@dataclass(frozen=True, kw_only=True)
class ComposeCommand(OnRun):
    """Blend the task embeddings (LTEs) of two tasks of different kinds, to do both at once: f(β Z₁ + (1 − β) Z₂).

    Example: ear compose pretrained:halfcheetah-run-jump --between back-3 jump-5
    """

    between: Annotated[tuple[str, str], tyro.conf.arg(metavar="A B")]
    """Two training tasks, as in walk stand, or LTEs saved by `ear adapt --save`."""
    beta: Annotated[tuple[float, ...], tyro.conf.arg(metavar="[β ...]")] = BETAS
    """The blends: 1 is the first task, 0 the second; values outside [0, 1] extrapolate."""
    steps: int = 1000
    """Environment steps per blend."""


def main(words: list[str]) -> None:
    command = parse(ComposeCommand, words, "compose")
    check_least(command, steps=2)
    if not command.beta:
        raise UsageError("--beta needs at least one number, as in --beta 1 0.5 0")
    check_betas(command.beta)
    trained = command.load()
    from ear_jax.cli.ends import find_end
    from ear_jax.embeddings.compose import compose
    from ear_jax.figures.compose import draw_compose

    first, second = (find_end(trained, word) for word in command.between)
    if first.name == second.name:
        raise UsageError(f"--between {' '.join(command.between)} names one task twice")
    with phase(f"rolling out {counted(len(command.beta), 'blend')}"):
        document = compose(trained, first, second, command.beta, command.steps, command.seed)
    kept = partial(keep, trained.directory, "composition", label_of(command), document, draw_compose)
    show_and_keep(document, command.json, _print, kept)


def _print(document: dict[str, Any]) -> None:
    """Prints one row per seed and blend."""
    names = list(document["seeds"][0]["blends"][0]["outcome"])
    headings = ("seed>", "β>", *(f"{name}>" for name in (*names, *(f"{foot} foot down" for foot in document["feet"]))))
    rows = []
    for entry in document["seeds"]:
        for blend in entry["blends"]:
            outcomes = (f"{blend['outcome'][name]:.2f}" for name in names)
            feet = (f"{blend['contact'][foot]:.0%}" for foot in document["feet"])
            steps = f"{blend['length']}, fell" if blend["fell"] else str(blend["length"])
            rows.append((str(entry["seed"]), f"{blend['beta']:g}", *outcomes, *feet, steps))
    title = f"{document['between'][0]} (β = 1) to {document['between'][1]} (β = 0)"
    print_table((*headings, "steps>"), rows, title)
