"""`ear interpolate RUN`."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any, Literal

from ear_jax.cli.arguments import check_betas, check_finite, check_least, option, parse
from ear_jax.cli.on_run import OnRun
from ear_jax.cli.results import keep, label_of, print_table, show_and_keep
from ear_jax.errors import UsageError, counted
from ear_jax.process.terminal import phase

if TYPE_CHECKING:
    from ear_jax.embeddings.interpolate import Pair
    from ear_jax.runs.trained import Trained

HEADINGS = {
    "beta": "β",
    "outcome": "achieved",
    "mid_task": "midway",
    "one_to_one": "between",
    "one_to_one_outcome": "at β = ½",
    "fresh_outcome": "again",
    "fresh": "holds",
}
MEASURES = {
    "mid_task": "midway: a blend, β from 0.1 to 0.9, meets the value midway",
    "fresh": "holds: in 10 fresh episodes the blend found, `again`, still meets the value",
    "one_to_one": "between: the half-and-half blend, β = ½, lies between the two tasks",
}


@dataclass(frozen=True, kw_only=True)
class InterpolateCommand(OnRun):
    """Blend the task embeddings (LTEs) of two tasks, to do what lies between or beyond them: f(β Z₁ + (1 − β) Z₂).

    Example: ear interpolate pretrained:halfcheetah-vel --between 2 3 --target 2.5
    """

    between: Annotated[tuple[str, str] | None, option("A B")] = None
    """Two training tasks, as in 2 3, or LTEs saved by `ear adapt --save`."""
    all_pairs: bool = False
    """All pairs of neighbouring training tasks."""
    target: Annotated[float | None, option("X", "midway")] = None
    """Find the β that comes nearest to this value between the two tasks."""
    beta: Annotated[tuple[float, ...], option("[β ...]")] = ()
    """Play these β instead of meeting a target; values outside [0, 1] extrapolate."""
    along: Literal["chord", "arc"] = "chord"
    """Blend along the chord, the paper's normalised sum, or along the great circle."""
    episodes: int = 3
    """Episodes per blend."""


def main(words: list[str]) -> None:
    command = parse(InterpolateCommand, words, "interpolate")
    if command.all_pairs == (command.between is not None):
        raise UsageError("give either --between A B or --all-pairs")
    if command.target is not None and (command.beta or command.all_pairs):
        raise UsageError("--target goes only with --between A B, and without --beta")
    check_betas(command.beta)
    if command.target is not None:
        check_finite("--target", command.target)
    check_least(command, episodes=1)
    trained = command.load()
    from ear_jax.cli.ends import find_pair
    from ear_jax.embeddings.interpolate import BETAS, adjacent_pairs, interpolate, trained_ends
    from ear_jax.figures.interpolate import draw_interpolate

    if command.between:
        pairs = [find_pair(trained, *command.between, targets=not command.beta)]
    else:
        pairs = adjacent_pairs(trained_ends(trained), trained.program.family)
    with phase(f"rolling out {counted(len(command.beta or BETAS), 'blend')} of {counted(len(pairs), 'pair')}"):
        if command.beta:
            document = _at_betas(trained, pairs, command)
        else:
            document = interpolate(trained, pairs, command.target, command.episodes, command.seed, command.along)
    kept = partial(keep, trained.directory, "interpolation", label_of(command), document, draw_interpolate)
    show_and_keep(document, command.json, _print, kept)


def _at_betas(trained: Trained, pairs: list[Pair], command: InterpolateCommand) -> dict[str, Any]:
    """Plays the given β and returns the document, with `blends` in place of `pairs`."""
    from ear_jax.embeddings.interpolate import play_blends

    achieved = play_blends(trained, pairs, command.beta, command.episodes, command.seed, command.along)
    return {
        "blends": [
            {
                "seed": trained.program.config.seed + index,
                "between": [first.name, second.name],
                "beta": beta,
                "outcome": float(value),
            }
            for index, rows in enumerate(achieved)
            for (first, second), row in zip(pairs, rows, strict=True)
            for beta, value in zip(command.beta, row, strict=True)
        ],
        "commanded": trained.program.family.quantity,
    }


def _print(document: dict[str, Any]) -> None:
    """Prints one row per pair or blend, and the counts of the paper's two measures."""
    rows = document.get("pairs") or document["blends"]
    columns = [key for key in rows[0] if key not in ("between", "curve")]
    headings = (f"{HEADINGS.get(name, name)}{'>' * isinstance(rows[0][name], float)}" for name in columns)
    cells = [("–".join(row["between"]), *(_show(row[key]) for key in columns)) for row in rows]
    print_table(("pair", *headings), cells)
    print(f"values are in {document['commanded']['unit']}")
    for measure, meaning in MEASURES.items():
        if measure in document:
            print(f"{meaning}: {document[measure]['success']} of {document[measure]['total']} pairs")


def _show(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.2f}" if isinstance(value, float) else str(value)
