"""`ear front RUN`."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any

from ear_jax.cli.arguments import option, parse, shield
from ear_jax.cli.on_run import OnRun
from ear_jax.cli.results import check_writable, keep, label_of, print_table, show_and_keep
from ear_jax.errors import UsageError
from ear_jax.process.terminal import phase

SHOWN = 12  # LTEs of a front that are printed at most


@dataclass(frozen=True, kw_only=True)
class FrontCommand(OnRun):
    """Draw what two rewards trade against each other, under task embeddings (LTEs) all over their sphere.

    The Pareto front consists of the LTEs that no other beats in both. The sphere is surveyed once, as for `ear adapt
    --reward`.

    Example: ear front pretrained:halfcheetah-run-jump --reward "abs(velocity)" height
    """

    reward: Annotated[tuple[str, ...], option("EXPR EXPR")] = ()
    """The two rewards: expressions over the family's outcomes, as `ear adapt --reward` takes them."""


def main(words: list[str]) -> None:
    command = parse(FrontCommand, shield(words), "front")
    if len(command.reward) != 2:
        raise UsageError(f'name two rewards, as in --reward "-velocity" height, not {len(command.reward)}')
    trained = command.load()
    from ear_jax.embeddings.front import trade
    from ear_jax.embeddings.survey import PLACES
    from ear_jax.envs.asked import reward_functions
    from ear_jax.figures.front import draw_front

    rewards = reward_functions(trained.program.family, [text.strip() for text in command.reward])
    check_writable(trained.directory)
    with phase("finding the front"):
        document = trade(trained, rewards, command.seed, PLACES)
    kept = partial(keep, trained.directory, "front", label_of(command), document, draw_front)
    show_and_keep(document, command.json, _print, kept)


def _print(document: dict[str, Any]) -> None:
    """Prints LTEs of each front, evenly chosen, and how many there are."""
    for entry in document["seeds"]:
        front = entry["front"]
        count = min(SHOWN, len(front))
        chosen = [front[index * (len(front) - 1) // max(count - 1, 1)] for index in range(count)]
        rows = [
            (*(f"{value:.3f}" for value in entry["rewards"][row]), " ".join(f"{x:.4f}" for x in entry["ltes"][row]))
            for row in chosen
        ]
        title = f"seed {entry['seed']}: {count} of {len(front)} LTEs on the front, of {len(entry['ltes'])} played"
        print_table((*(f"{name}>" for name in document["rewards"]), "LTE"), rows, title)
