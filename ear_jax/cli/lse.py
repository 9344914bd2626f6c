"""`ear lse RUN`."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any

from ear_jax.cli.arguments import option, parse
from ear_jax.cli.on_run import OnRun
from ear_jax.cli.results import keep, label_of, show_and_keep
from ear_jax.process.terminal import phase


@dataclass(frozen=True, kw_only=True)
class LseCommand(OnRun):
    """Compare the sensory embedding (LSE) along a gait with the raw state: principal components and periodicity.

    Example: ear lse pretrained:halfcheetah-vel --task 2
    """

    task: Annotated[str | None, option("TASK", "the middle one")] = None
    """A training task, as in 2."""


def main(words: list[str]) -> None:
    command = parse(LseCommand, words, "lse")
    trained = command.load()
    from ear_jax.embeddings.lse import lse
    from ear_jax.envs import find_task
    from ear_jax.figures.lse import draw_lse

    tasks = trained.program.tasks
    row = len(tasks) // 2 if command.task is None else tasks.index(find_task(trained.program.family, command.task).name)
    task = tasks.names[row]
    with phase("playing an episode"):
        document = lse(trained, task, command.seed)
    kept = partial(keep, trained.directory, "lse", label_of(command), document, draw_lse)
    show_and_keep(document, command.json, _print, kept)


def _print(document: dict[str, Any]) -> None:
    from ear_jax.figures.lse import NAMES

    for entry in document["seeds"]:
        for key, name in NAMES.items():
            signal = entry[key]
            period = f"period {signal['period']:.2f} s (autocorrelation {signal['autocorrelation_peak']:.2f})"
            share = f"the first two principal components hold {sum(signal['explained']):.0%} of the variance"
            print(f"seed {entry['seed']}, {name}: {period if signal['period'] else 'no period'}; {share}")
