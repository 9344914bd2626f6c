"""`ear refine RUN FILE`."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import tyro

from ear_jax.cli.arguments import check_finite, check_least, parse
from ear_jax.cli.on_run import OnRun
from ear_jax.cli.results import check_writable, keep, print_table, show_and_keep
from ear_jax.errors import UsageError
from ear_jax.pretrained import SUFFIX


@dataclass(frozen=True, kw_only=True)
class RefineCommand(OnRun):
    """Teach a policy what schedules of its own task embeddings (LTEs) do better, and write the new policy to a file.

    A search finds for each task the LTEs, and small pushes of the actions, under which an episode returns most; then
    the networks learn to play that under the task's own LTE. All LTEs stay where they are.

    Example: ear refine pretrained:hopper-vel refined.safetensors
    """

    file: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="FILE")]]
    """The new file, which must end in .safetensors; it takes the place of a run in every command."""
    rounds: int = 2
    """Rounds of searching and teaching, each with the policy of the round before."""
    epochs: int = 12
    """Epochs of each search."""
    candidates: int = 48
    """Schedules that an epoch tries for each task."""
    starts: int = 2
    """Random starts from which each is played."""
    push: float = 0.3
    """Standard deviation of what the search adds to actions, before tanh; 0: it only changes LTEs."""
    passes: int = 3
    """Passes of teaching a round: the policy plays, is corrected, and learns from all corrections."""
    updates: int = 600
    """Gradient steps of each pass."""
    episodes: int = 20
    """Fresh episodes a task in which the policy before and after is compared."""


def main(words: list[str]) -> None:
    command = parse(RefineCommand, words, "refine")
    check_least(command, rounds=1, epochs=1, candidates=8, starts=1, passes=1, updates=1, episodes=1)
    check_finite("--push", command.push)
    if command.push < 0:
        raise UsageError(f"--push {command.push:g} is too small; it must be at least 0")
    if command.file.suffix != SUFFIX:
        raise UsageError(f"{command.file} must end in {SUFFIX}")
    if command.file.exists():
        raise UsageError(f"{command.file} already exists; name another file")
    check_writable(command.file.parent)
    trained = command.load()
    from ear_jax.embeddings.refine import Refinement, refine
    from ear_jax.embeddings.schedule import ScheduleSearch
    from ear_jax.embeddings.teach import Teaching
    from ear_jax.figures.refine import draw_refine
    from ear_jax.runs.trained import results_of, save

    search = ScheduleSearch(command.epochs, command.candidates, command.starts, push=command.push)
    settings = Refinement(command.rounds, search, Teaching(passes=command.passes, updates=command.updates))
    refined, document = refine(trained, settings, command.episodes, command.seed)
    save(command.file, refined, [])
    document = {**document, "file": str(command.file)}
    kept = partial(keep, results_of(command.file), "refinement", "", document, draw_refine)
    show_and_keep(document, command.json, _print, kept)


def _print(document: dict[str, Any]) -> None:
    """Prints for each seed the returns of its tasks before and after, and those of the last schedules."""
    for entry in document["seeds"]:
        last = entry["rounds"][-1]
        columns = (entry["returns"], last["returns_scheduled"], last["returns_refined"])
        means = (entry["mean_return"], last["scheduled"], last["refined"])
        rows = [
            (name, *(f"{value:.1f}" for value in values))
            for name, *values in (*zip(entry["tasks"], *columns, strict=True), ("mean", *means))
        ]
        title = f"seed {entry['seed']}: returns of {document['episodes']} fresh episodes a task"
        print_table(("task", "before>", "last schedules>", "refined>"), rows, title)
    print(f"{document['env_steps']:,} env steps and {document['updates']:,} updates per seed; {document['file']}")
