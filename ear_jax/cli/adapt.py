"""`ear adapt RUN`."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

from rich.console import Console
from rich.table import Table

from ear_jax.cli.arguments import check_finite, check_least, parse
from ear_jax.cli.on_run import OnRun
from ear_jax.embeddings import ltes
from ear_jax.embeddings.adapt import adapt
from ear_jax.embeddings.search import Search, episodes_an_epoch
from ear_jax.envs import find_task
from ear_jax.errors import UsageError
from ear_jax.figures.adapt import draw_search
from ear_jax.process.terminal import phase
from ear_jax.runs import records
from ear_jax.runs.trained import Trained
from ear_jax.tasks import task_set


@dataclass(frozen=True, kw_only=True)
class AdaptCommand(OnRun):
    """Find codes for tasks the policy was never trained on, by the cross-entropy method; PEARL infers, MAML tunes."""

    target: tuple[str, ...] = ()
    """The tasks, as in 3.6; by default the family's adaptation tasks."""
    zero_shot: bool = False
    """Do not search: take the code that a map of the sphere promises."""
    save: str | None = None
    """Keep the LTE found for the one target under this name; other commands take it as --lte NAME."""
    epochs: int = 10
    """Epochs of the search; of PEARL, episodes a code is inferred from; of MAML, gradient steps."""
    elites: int = 6
    """Codes kept from one epoch to the next."""
    samples: int = 14
    """Neighbours of each that are tried."""
    sigma: float = 0.5
    """How far away, a standard deviation a coordinate."""
    episodes: int = 5
    """Fresh episodes by which an epoch's best is judged again."""


def main(words: list[str]) -> None:
    command = parse(AdaptCommand, words, "adapt")
    check_least(command, epochs=1, elites=1, episodes=1)
    check_finite("--sigma", command.sigma)
    if command.samples < 0 or not command.sigma > 0:
        raise UsageError("--samples must be at least 0 and --sigma above 0")
    if command.save is not None:
        ltes.check_name(command.save)
        if len(command.target) != 1:
            raise UsageError(f"--save {command.save} names one LTE; give one --target")
    trained = command.load()
    family = trained.program.family
    named = [find_task(family, text) for text in command.target]
    tasks = task_set(named) if named else family.adaptation_tasks(command.seed)
    if not len(tasks):
        raise UsageError(f"{family.name} has no adaptation tasks of its own; name some with --target")
    search = Search(command.epochs, command.elites, command.samples, command.sigma)
    if command.zero_shot and any(task.target is None for task in tasks.tasks):
        raise UsageError(f"--zero-shot answers tasks that command a {family.commanded}")
    if command.save is not None:
        _check_save(command.save, trained)
    finds = trained.program.agent.finds_codes
    if finds and search != Search(search.epochs):
        agent = trained.program.config.agent
        raise UsageError(f"--elites, --samples and --sigma are of a search, and {agent} finds its codes without one")
    each = episodes_an_epoch(trained.program, search)
    what = f"searching {len(tasks)} × {search.epochs} × {each}"
    if finds:
        what = f"finding {len(tasks)} codes from {search.epochs * each} episodes each"
    with phase("mapping the sphere" if command.zero_shot else what):
        document = adapt(trained, tasks, None if command.zero_shot else search, command.episodes, command.seed)
    records.write_json(trained.directory / "adaptation.json", {**document, **records.provenance()})
    if command.save is not None:
        codes = [task["lte"] for task in document["tasks"]]
        ltes.save(trained.directory, command.save, tasks.names[0], codes, trained.fingerprint)
    pictures = draw_search(trained.directory / "figures", document)
    if command.json:
        print(json.dumps({**document, "figures": [str(path) for path in pictures]}))
        return
    _print(document, family.unit)
    if pictures:
        print("pictures: " + ", ".join(str(path) for path in pictures))


def _check_save(name: str, trained: Trained) -> None:
    """Refuses a name that would hide a task, and an agent without LTEs."""
    if trained.program.agent.tuned:
        raise UsageError(f"--save {name}: {trained.program.config.agent} has no LTEs to keep")
    try:
        task = find_task(trained.program.family, name).name
    except UsageError:
        return
    raise UsageError(f"--save {name} would hide the task {task}; choose another name")


def _print(document: dict[str, Any], unit: str) -> None:
    tasks, searched = document["tasks"], bool(document["env_steps"])
    title = f"{document['env_steps']:,} env steps of search, {document['seconds']:.0f} s" if searched else None
    table = Table(title=title, title_justify="left")
    table.add_column("task", no_wrap=True)
    for heading in (*(("1st best", "3rd", "last", "again", unit) if searched else ()), "map", unit):
        table.add_column(heading, justify="right", no_wrap=True)
    several = len({task["seed"] for task in tasks}) > 1
    names = [f"{task['name']} seed {task['seed']}" if several else task["name"] for task in tasks]
    for name, task in zip(names, tasks, strict=True):
        env_states = [name]
        if searched:
            epochs = task["epochs"]
            env_states += [
                f"{epochs[min(epoch, len(epochs) - 1)]['best_of_epoch']:.1f}" for epoch in (0, 2, len(epochs) - 1)
            ]
            env_states += [f"{epochs[-1]['reevaluated']:.1f}", f"{epochs[-1]['achieved']:.2f}"]
        answer = task["zero_shot"]
        env_states += [f"{answer['reevaluated']:.1f}", f"{answer['achieved']:.2f}"] if answer else ["–", "–"]
        table.add_row(*env_states)
    Console(highlight=False).print(table)
    if searched:
        print("best of the 1st, 3rd and last epoch; the last judged again by fresh episodes; what these achieved")
    if document["map_env_steps"]:
        print("map: the return, without search, of the code that a map of the sphere promises; what it achieved")
        print(f"the map took {document['map_env_steps']:,} env steps")
        for name, task in zip(names, tasks, strict=True):
            if task["target"] is not None and not task["zero_shot"]:
                print(f"the map knows no code near {name}")
    for name, task in zip(names, tasks, strict=True):
        if task["lte"]:
            print(f"LTE for {name}: " + " ".join(f"{number:.4f}" for number in task["lte"]))
