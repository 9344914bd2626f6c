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
    """Improve a trained policy by PPO, from whole episodes of all its tasks, and write the new policy to a file.

    All task embeddings (LTEs) stay where they are. Repeat the command to continue one that was stopped.

    Example: ear refine pretrained:hopper-vel refined.safetensors
    """

    file: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="FILE")]]
    """The new file, which must end in .safetensors; it takes the place of a run in every command."""
    iterations: int = 300
    """Iterations, each of fresh episodes and of updates from them."""
    train_episodes: int = 8
    """Episodes of each task in an iteration."""
    passes: int = 3
    """Passes over an iteration's steps."""
    divergence: float = 0.03
    """KL divergence by which an iteration changes the policy, at first; it falls to a tenth, and sets the step size."""
    noise: float = 0.5
    """Factor on the policy's σ while it plays, which is at least 0.1."""
    discount: float = 0.995
    """Discount factor γ."""
    episodes: int = 20
    """Fresh episodes a task in which the policy before and after is compared."""


def main(words: list[str]) -> None:
    command = parse(RefineCommand, words, "refine")
    check_least(command, iterations=1, train_episodes=1, passes=1, episodes=1)
    for name in ("divergence", "noise", "discount"):
        check_finite(f"--{name}", getattr(command, name))
    if command.divergence <= 0:
        raise UsageError(f"--divergence {command.divergence:g} is too small; it must be above 0")
    if command.noise < 0:
        raise UsageError(f"--noise {command.noise:g} is too small; it must be at least 0")
    if not 0 < command.discount <= 1:
        raise UsageError(f"--discount {command.discount:g} is out of range; it must be above 0 and at most 1")
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

    ppo = Ppo(
        episodes=command.train_episodes,
        passes=command.passes,
        divergence=command.divergence,
        noise=command.noise,
        discount=command.discount,
    )
    part = command.file.with_suffix(".part")
    refined, document = refine(trained, Refinement(command.iterations, ppo), command.episodes, command.seed, part)
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
