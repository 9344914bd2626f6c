"""`ear adapt RUN`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any

from ear_jax.cli.arguments import check_finite, check_least, option, parse, shield
from ear_jax.cli.on_run import OnRun
from ear_jax.cli.results import check_writable, keep, label_of, print_table, show_and_keep
from ear_jax.embeddings import ltes
from ear_jax.errors import RunError, UsageError, counted, plain
from ear_jax.process.terminal import phase, say

if TYPE_CHECKING:
    from ear_jax.embeddings.search import Search
    from ear_jax.runs.trained import Trained
    from ear_jax.tasks import TaskSet


SEARCH = ("epochs", "elites", "samples", "sigma")


@dataclass(frozen=True, kw_only=True)
class AdaptCommand(OnRun):
    """Find task embeddings (LTEs) for tasks never trained on or for any reward, by search and from a map of the sphere.

    PEARL infers from episodes of the task, and MAML takes gradient steps, instead of a search.

    Example: ear adapt pretrained:halfcheetah-vel --target 3.6 --save trot
    """

    target: Annotated[tuple[str, ...], option("[TASK ...]", "the family's adaptation tasks")] = ()
    """The tasks, as in 3.6."""
    reward: Annotated[tuple[str, ...], option("[EXPR ...]")] = ()
    """Rewards instead, as in "-abs(velocity - 3)": of the outcomes, with + - * / **, comparisons, and, or, not,
    X if … else Y, abs, clip, cos, exp, log, max, min, sign, sin, sqrt, tanh."""
    zero_shot: bool = False
    """Take the LTE from a map of the LTE sphere, without a search and its options."""
    save: Annotated[str | None, option("NAME")] = None
    """Save the LTE of the only target or reward under this name; other commands take it as --lte NAME."""
    epochs: int = 10
    """Epochs of the search; for PEARL, episodes to infer from; for MAML, gradient steps."""
    elites: int = 6
    """LTEs kept from one epoch to the next."""
    samples: int = 14
    """Neighbours tried around each of those."""
    sigma: float = 0.5
    """Distance of the neighbours: standard deviation in each coordinate."""
    episodes: int = 5
    """Fresh episodes in which the best LTE of each epoch is evaluated again."""


def main(words: list[str]) -> None:
    command = parse(AdaptCommand, shield(words), "adapt")
    _check(command)
    trained = command.load()
    if command.reward:
        _ask(command, trained)
    else:
        _adapt(command, trained)


def _adapt(command: AdaptCommand, trained: Trained) -> None:
    """Adapts to tasks of the family."""
    from ear_jax.embeddings.adapt import adapt
    from ear_jax.embeddings.search import Search, episodes_an_epoch
    from ear_jax.envs import find_task
    from ear_jax.tasks import task_set

    family = trained.program.family
    named = [find_task(family, text) for text in command.target]
    tasks = task_set(named) if named else family.adaptation_tasks(command.seed)
    if not len(tasks):
        raise UsageError(f"{family.name} has no adaptation tasks of its own; name some with --target")
    search = Search(command.epochs, command.elites, command.samples, command.sigma)
    _check_for(trained, command, search, tasks)
    each = search.epochs * episodes_an_epoch(trained.program, search)
    searching = f"adapting to {counted(len(tasks), 'task')}, {counted(each, 'episode')} each"
    with phase("mapping the LTE sphere" if command.zero_shot else searching):
        chosen = None if command.zero_shot else search
        document = adapt(trained, tasks, chosen, command.episodes, command.seed, within_reach=bool(named))
    _show(command, trained, document, partial(_print, unit=family.unit))


def _ask(command: AdaptCommand, trained: Trained) -> None:
    """Finds LTEs for rewards."""
    from ear_jax.embeddings.rewards import adapt_to_rewards
    from ear_jax.embeddings.search import Search
    from ear_jax.embeddings.survey import PLACES
    from ear_jax.envs.asked import reward_functions

    rewards = reward_functions(trained.program.family, [text.strip() for text in command.reward])
    search = Search(command.epochs, command.elites, command.samples, command.sigma)
    _check_search(trained, search)
    if command.save is not None:
        _check_save(command.save, trained)
        check_writable(trained.directory)
    with phase(f"adapting to {counted(len(command.reward), 'reward')}"):
        chosen = None if command.zero_shot else search
        document = adapt_to_rewards(trained, rewards, chosen, command.episodes, command.seed, PLACES)
    _show(command, trained, document, _print_rewards)


def _check(command: AdaptCommand) -> None:
    """Raises UsageError for options that are wrong for any run."""
    check_least(command, epochs=1, elites=1, samples=0, episodes=1)
    check_finite("--sigma", command.sigma)
    if not command.sigma > 0:
        raise UsageError(f"--sigma {command.sigma:g} is too small; it must be above 0")
    changed = next((name for name in SEARCH if getattr(command, name) != getattr(AdaptCommand, name)), None)
    if command.zero_shot and changed:
        raise UsageError(f"--{changed} sets up a search, which --zero-shot leaves out; give one of the two")
    if command.save is not None:
        ltes.check_name(command.save)
        if len(command.target) + len(command.reward) != 1:
            raise UsageError(
                f"--save {command.save} saves the LTE of one task; name one task with --target or one --reward"
            )
    if command.target and command.reward:
        raise UsageError("give either --target X or --reward EXPR")


def _check_for(trained: Trained, command: AdaptCommand, search: Search, tasks: TaskSet) -> None:
    """Raises UsageError for options that are wrong for this run or these tasks."""
    family = trained.program.family
    untargeted = [task.name for task in tasks.tasks if task.target is None]
    if command.zero_shot and untargeted:
        raise UsageError(f"--zero-shot needs tasks with a target {family.commanded}; {untargeted[0]} has none")
    if command.save is not None:
        _check_save(command.save, trained)
        check_writable(trained.directory)
    _check_search(trained, search)


def _check_search(trained: Trained, search: Search) -> None:
    """Raises UsageError for settings of a search that this run's agent does not use."""
    if trained.program.agent.finds_codes and search != type(search)(search.epochs):
        agent = trained.program.config.agent
        raise UsageError(f"--elites, --samples and --sigma set up the cross-entropy method, which {agent} does not use")


def _check_save(name: str, trained: Trained) -> None:
    """Raises UsageError for a name that would hide a task or an agent without LTEs, RunError for a damaged file."""
    if trained.program.agent.tuned:
        raise UsageError(f"--save {name}: {trained.program.config.agent} has no LTEs to save")
    ltes.saved(trained.directory)
    from ear_jax.envs import find_task

    try:
        task = find_task(trained.program.family, name).name
    except UsageError:
        return
    raise UsageError(f"--save {name} would hide the task {task}; choose another name")


def _show(
    command: AdaptCommand, trained: Trained, document: dict[str, Any], print_text: Callable[[dict[str, Any]], None]
) -> None:
    """Saves LTEs if asked to, keeps the document and shows it; raises RunError, last, if LTEs cannot be saved."""
    from ear_jax.figures.adapt import draw_adapt

    failed = None
    try:
        if command.save is not None:
            _save(command, trained, document, command.save)
    except RunError as error:
        failed = error
    kept = partial(keep, trained.directory, "adaptation", label_of(command), document, draw_adapt)
    show_and_keep(document, command.json, print_text, kept)
    if failed:
        raise failed


def _save(command: AdaptCommand, trained: Trained, document: dict[str, Any], name: str) -> None:
    """Saves the LTEs found under a name and says so; of a search's and the map's the one that returned more."""
    found = [_better(task) for task in document["tasks"]]
    codes, task = [lte for _, lte in found], document["tasks"][0]["name"]
    asked_by = "--reward" if command.reward else "--target"
    ltes.save(trained.directory, name, task, codes, trained.fingerprint, asked_by)
    ways = " and ".join(dict.fromkeys(way for way, _ in found))
    say(f"saved as {name}: the LTE found by {ways}; other commands take it as --lte {name}")


def _better(task: dict[str, Any]) -> tuple[str, list[float]]:
    """Returns the way by which a task's better LTE was found, and that LTE."""
    if "best" in task:
        return task["best"], task["lte"]
    answer, epochs = task["zero_shot"], task["epochs"]
    if answer and (not epochs or answer["reevaluated"] > epochs[-1]["reevaluated"]):
        return "map", answer["lte"]
    return "search", task["lte"]


def _print(document: dict[str, Any], unit: str) -> None:
    """Prints one row per task and seed, the meaning of the columns, and the LTEs."""
    tasks, searched = document["tasks"], bool(document["env_steps"])
    title = f"{document['env_steps']:,} env steps of search, {document['seconds']:.0f} s" if searched else None
    headings = (*(("1st best>", "3rd>", "last>", "fresh>", f"{unit}>") if searched else ()), "map>", f"{unit}>")
    several = len({task["seed"] for task in tasks}) > 1
    names = [f"{task['name']} seed {task['seed']}" if several else task["name"] for task in tasks]
    rows = [
        (name, *(_of_search(task["epochs"]) if searched else ()), *_of_map(task["zero_shot"]))
        for name, task in zip(names, tasks, strict=True)
    ]
    print_table(("task", *headings), rows, title)
    if searched:
        print("1st best, 3rd, last: highest return among the candidates of that epoch")
        print("fresh: the last one's return in fresh episodes, and what it achieved")
    if document["map_env_steps"]:
        print("map: return, without search, of the LTE chosen from a map of the LTE sphere, and what it achieved")
        print(f"the map took {document['map_env_steps']:,} env steps")
        for name, task in zip(names, tasks, strict=True):
            if task["target"] is not None and not task["zero_shot"]:
                print(f"no LTE on the map comes near {plain(name)}")
    for name, task in zip(names, tasks, strict=True):
        if task["lte"]:
            way, lte = _better(task)
            print(f"best LTE for {plain(name)}, by {way}: " + " ".join(f"{number:.4f}" for number in lte))


def _of_search(epochs: list[dict[str, float]]) -> list[str]:
    last = len(epochs) - 1
    best = [f"{epochs[min(epoch, last)]['best_of_epoch']:.1f}" for epoch in (0, 2, last)]
    return [*best, f"{epochs[-1]['reevaluated']:.1f}", f"{epochs[-1]['achieved']:.2f}"]


def _of_map(answer: dict[str, Any] | None) -> list[str]:
    return [f"{answer['reevaluated']:.1f}", f"{answer['achieved']:.2f}"] if answer else ["–", "–"]


WAYS = {
    "map": "map: from a survey of the LTE sphere",
    "imagined": "imagined: from what `ear imagine` learnt",
    "search": "search: by the cross-entropy method",
}


def _print_rewards(document: dict[str, Any]) -> None:
    """Prints a row per reward, seed and way, the costs of the ways, and the best LTEs."""
    tasks, several = document["tasks"], len({task["seed"] for task in document["tasks"]}) > 1
    names = [f"{task['name']} seed {task['seed']}" if several else task["name"] for task in tasks]
    rows = [
        (
            name if way == next(iter(task["answers"])) else "",
            way,
            f"{answer['predicted']:.1f}",
            f"{answer['reevaluated']:.1f}",
            ", ".join(f"{outcome} {value:.2f}" for outcome, value in answer["outcome"].items()),
        )
        for name, task in zip(names, tasks, strict=True)
        for way, answer in task["answers"].items()
    ]
    print_table(("reward", "way", "predicted>", "return>", "mean outcomes, second half"), rows)
    print(f"return: the sum of rewards over an episode, mean of {document['episodes']} fresh episodes")
    for way, cost in document["costs"].items():
        print(f"{WAYS[way]}, {cost['env_steps']:,} env steps, {cost['seconds']:.1f} s")
    for name, task in zip(names, tasks, strict=True):
        print(f"best LTE for {plain(name)}, by {task['best']}: " + " ".join(f"{number:.4f}" for number in task["lte"]))
