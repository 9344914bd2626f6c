"""`ear imagine RUN`."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

from ear_jax.cli.arguments import check_finite, check_least, check_most, parse
from ear_jax.cli.on_run import OnRun
from ear_jax.cli.results import check_writable, keep, label_of, print_table, show_and_keep
from ear_jax.errors import UsageError
from ear_jax.process.terminal import phase


@dataclass(frozen=True, kw_only=True)
class ImagineCommand(OnRun):
    """Learn from a run's replay what the robot would do under any LTE, so that `ear adapt --reward` needs no roll-out.

    It learns the successor measure of outcomes. An agent that ships has no replay; episodes under the LTEs of its
    training tasks are played instead.

    Example: ear imagine pretrained:halfcheetah-vel
    """

    updates: int = 6000
    """Updates of the network."""
    batch_size: int = 256
    """Transitions in each of them."""
    cells: int = 256
    """Kinds of outcomes that it tells apart."""
    discount: float = 0.95
    """The discount γ of later outcomes: 0.95 looks about 20 steps ahead. An episode is a chain of such looks."""


def main(words: list[str]) -> None:
    command = parse(ImagineCommand, words, "imagine")
    check_least(command, updates=1, batch_size=1, cells=2)
    check_most(command, updates=10**9, batch_size=2**16, cells=2**12)
    check_finite("--discount", command.discount)
    if not 0 <= command.discount < 1:
        raise UsageError(f"--discount {command.discount:g} is out of range; it must be from 0 to below 1")
    trained = command.load()
    from ear_jax.embeddings.imagine import imagine
    from ear_jax.figures.imagine import draw_imagine
    from ear_jax.learning.measure import MeasureConfig

    check_writable(trained.directory)
    config = MeasureConfig(
        cells=command.cells,
        updates=command.updates,
        batch_size=command.batch_size,
        discount=command.discount,
    )
    with phase(f"imagining the sphere in {command.updates:,} updates"):
        document = imagine(trained, config, command.seed)
    kept = partial(keep, trained.directory, "imagination", label_of(command), document, draw_imagine)
    show_and_keep(document, command.json, _print, kept)


def _print(document: dict[str, Any]) -> None:
    """Prints the outcomes imagined under the LTEs of the training tasks, and what they were learnt from."""
    several = len(document["seeds"]) > 1
    names = list(document["seeds"][0]["trained"][0]["imagined"])
    rows = [
        (
            f"{task['name']} seed {entry['seed']}" if several else task["name"],
            *(f"{task['imagined'][name]:.2f}" for name in names),
        )
        for entry in document["seeds"]
        for task in entry["trained"]
    ]
    print_table(("task", *(f"{name}>" for name in names)), rows, "imagined, mean over the second half of an episode:")
    source = "the replay" if document["source"] == "replay" else "episodes under the LTEs of the training tasks, played"
    steps = f" in {document['env_steps']:,} env steps" if document["env_steps"] else ""
    print(
        f"learnt in {document['seconds']:.0f} s from {document['transitions']:,} transitions a seed of {source}{steps}"
    )
