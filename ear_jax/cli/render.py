"""`ear render RUN`."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Annotated, Literal

import tyro

from ear_jax.cli.arguments import check_betas, check_least, option, parse
from ear_jax.cli.on_run import OnPolicy
from ear_jax.cli.results import check_writable, label_of, print_pictures
from ear_jax.errors import UsageError
from ear_jax.process.terminal import phase


@dataclass(frozen=True, kw_only=True)
class RenderCommand(OnPolicy):
    """Draw the robot as a stop-motion strip and film it, under training tasks, a task embedding (LTE) or blends.

    Example: ear render pretrained:hopper-vel --interpolate 1.8 2 --no-film
    """

    task: Annotated[tuple[str, ...], option("[TASK ...]")] = ()
    """Training tasks, as in 2 or 1 2 3."""
    lte: Annotated[tuple[str, ...], option("NAME|X Y Z")] = ()
    """An LTE saved by `ear adapt --save`, or its numbers, as in 0.1 0.7 -0.7, which are projected onto the sphere."""
    interpolate: Annotated[tuple[str, str] | None, option("A B")] = None
    """Two training tasks, as in 1 2, or LTEs saved by `ear adapt --save`, and blends of them."""
    beta: Annotated[tuple[float, ...], option("[β ...]", "0.75 0.5 0.25")] = ()
    """The blends: 1 is the first task, 0 the second; values outside [0, 1] extrapolate."""
    along: Literal["chord", "arc"] = "chord"
    """Blend along the chord, the paper's normalised sum, or along the great circle."""
    film: Annotated[bool, tyro.conf.arg(help_behavior_hint="")] = True
    """Leave out the films, which take most of the time, and draw only the strip."""
    steps: int = 100
    """Environment steps; the default is that of the paper's figure 3."""


def main(words: list[str]) -> None:
    command = parse(RenderCommand, words, "render")
    _check(command)
    trained = command.load()
    import jax
    import jax.numpy as jnp

    from ear_jax.cli.shots import choose_shots, draw, file_name
    from ear_jax.embeddings.trajectory import follow
    from ear_jax.runs.trained import policy_of

    check_writable(trained.directory)
    program, policy = trained.program, policy_of(trained, command.policy)
    shots = choose_shots(command, trained, policy)
    with phase("rolling out"):
        codes = jnp.stack([shot.code for shot in shots])
        trajectories = follow(program, policy, codes, command.steps, jax.random.key(command.seed))
    name = file_name(command, shots) + label_of(command, without=("task", "lte", "interpolate"))
    files = draw(trained.directory, name, program.family, [shot.name for shot in shots], trajectories, command.film)
    if not command.json:
        print_pictures(files.values())
        return
    document = {
        "seed": program.config.seed + command.policy,
        "commanded": {"outcome": program.family.commanded, "unit": program.family.unit},
        "scenes": [
            {
                "name": shot.name,
                "lte": shot.code.tolist(),
                "steps": len(trajectory.qpos) - 1,
                "fell": trajectory.fell,
                "outcome": trajectory.achieved,
            }
            for shot, trajectory in zip(shots, trajectories, strict=True)
        ],
        "files": {kind: str(path) for kind, path in files.items()},
    }
    print(json.dumps(document))


def _check(command: RenderCommand) -> None:
    """Raises UsageError for options that are wrong for any run."""
    if sum(map(bool, (command.task, command.lte, command.interpolate))) != 1:
        raise UsageError("give one of --task X, --lte X Y Z and --interpolate A B")
    if command.beta and not command.interpolate:
        raise UsageError("--beta goes only with --interpolate A B")
    check_least(command, steps=1)
    check_betas(command.beta)
