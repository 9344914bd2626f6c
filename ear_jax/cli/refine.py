"""`ear refine RUN FILE`."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import tyro

from ear_jax.cli.arguments import check_finite, check_least, parse
from ear_jax.cli.on_run import OnRun
from ear_jax.cli.results import check_writable, keep, print_table, show_and_keep
from ear_jax.config import EnvConfig, flag
from ear_jax.errors import UsageError
from ear_jax.files.replacing import claim_file
from ear_jax.pretrained import SUFFIX


@dataclass(frozen=True, kw_only=True)
class RefineCommand(OnRun):
    """Improve a trained policy by PPO, from whole episodes of all its tasks, and write the new policy to a file.

    All task embeddings (LTEs) stay where they are. Repeat the command to continue one that was stopped.

    Example: ear refine pretrained:hopper-vel refined.safetensors
    """

    file: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="FILE")]]
    """The new file, which must end in .safetensors; every command that plays a policy takes it as a run."""
    iterations: int = 300
    """Iterations, each of fresh episodes and of updates from them."""
    iteration_episodes: int = 80
    """Episodes of an iteration, shared evenly by the tasks and rounded up for each."""
    divergence: float = 0.03
    """KL divergence by which an iteration changes the policy, at first; it falls to a tenth, and sets the step size."""
    noise: float = 0.5
    """Factor on the policy's σ while it plays."""
    least_noise: float = 0.1
    """The least σ while it plays, before tanh."""
    env: EnvConfig = field(default_factory=EnvConfig)
    """Options of the family while the policy learns, by default the run's. The returns told are always the run's."""
    episodes: int = 20
    """Fresh episodes a task in which the policy before and after is compared."""


def main(words: list[str]) -> None:
    command = parse(RefineCommand, words, "refine")
    check_least(command, iterations=1, iteration_episodes=1, episodes=1)
    numbers = {name: getattr(command, name) for name in ("divergence", "noise", "least_noise")}
    for name, number in numbers.items():
        check_finite(flag(name), number)
        if number < 0 or (number == 0 and name != "noise"):
            least = "at least 0" if name == "noise" else "above 0"
            raise UsageError(f"{flag(name)} {number:g} is too small; it must be {least}")
    if command.file.suffix != SUFFIX:
        raise UsageError(f"{command.file} must end in {SUFFIX}")
    if command.file.exists():
        raise UsageError(f"{command.file} already exists; name another file")
    check_writable(command.file.parent)
    trained = command.load()
    from ear_jax.figures.refine import draw_refine
    from ear_jax.learning.ppo import Ppo
    from ear_jax.runs.refine import Refinement, refine
    from ear_jax.runs.trained import results_of, save

    options = {name: value for name, value in asdict(command.env).items() if value is not None}
    settings = Refinement(command.iterations, Ppo(episodes=command.iteration_episodes, **numbers), options)
    part = command.file.with_suffix(".part")
    with claim_file(part):
        refined, document = refine(trained, settings, command.episodes, command.seed, part)
        save(command.file, refined, [])
        part.unlink(missing_ok=True)
    document = {**document, "file": str(command.file)}
    kept = partial(keep, results_of(command.file), "refinement", "", document, draw_refine)
    show_and_keep(document, command.json, _print, kept)


def _print(document: dict[str, Any]) -> None:
    """Prints for each seed the returns of its tasks before and after."""
    for entry in document["seeds"]:
        columns = (entry["tasks"], entry["returns_before"], entry["returns_after"])
        rows = [(name, f"{before:.1f}", f"{after:.1f}") for name, before, after in zip(*columns, strict=True)]
        rows.append(("mean", f"{entry['before']:.1f}", f"{entry['after']:.1f}"))
        title = f"seed {entry['seed']}: returns of {document['episodes']} fresh episodes a task"
        print_table(("task", "before>", "refined>"), rows, title)
    print(f"{document['env_steps']:,} env steps and {document['updates']:,} updates per seed; {document['file']}")
