"""`ear render RUN`."""

from __future__ import annotations

import json
import re
import textwrap
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import jax
import jax.numpy as jnp
import tyro

from ear_jax.agents.networks import Params
from ear_jax.cli.arguments import check_finite, check_least, option, parse
from ear_jax.cli.on_run import OnPolicy
from ear_jax.cli.results import print_pictures
from ear_jax.embeddings import ltes
from ear_jax.embeddings.interpolate import blend_codes
from ear_jax.embeddings.trajectory import Trajectory, follow
from ear_jax.envs import Family, find_task
from ear_jax.errors import RunError, UsageError
from ear_jax.figures.strip import draw_strip
from ear_jax.figures.video import write_gif, write_mp4
from ear_jax.process.terminal import phase, say
from ear_jax.rendering.film import arrange, film, photograph
from ear_jax.runs import records
from ear_jax.runs.trained import Trained, policy_of

BETAS = (0.75, 0.5, 0.25)


@dataclass(frozen=True, kw_only=True)
class RenderCommand(OnPolicy):
    """Draw the robot as a stop-motion strip and film it, under training tasks, a task embedding (LTE) or blends."""

    task: Annotated[tuple[str, ...], option("[TASK ...]")] = ()
    """Training tasks, as in 2 or 1 2 3."""
    lte: Annotated[tuple[str, ...], option("NAME|X Y Z")] = ()
    """An LTE saved by `ear adapt --save`, or its numbers, as in 0.1 0.7 -0.7, which are projected onto the sphere."""
    interpolate: Annotated[tuple[str, str] | None, option("A B")] = None
    """Two training tasks, as in 1 2, and blends of them."""
    beta: Annotated[tuple[float, ...], option("[β ...]", "0.75 0.5 0.25")] = ()
    """The blends: 1 is the first task, 0 the second; values outside [0, 1] extrapolate."""
    along: Literal["chord", "arc"] = "chord"
    """Blend along the chord, the paper's normalised sum, or along the great circle."""
    film: Annotated[bool, tyro.conf.arg(help_behavior_hint="")] = True
    """Draw only the strip. The GIF and the MP4 take most of the time."""
    steps: int = 100
    """Environment steps; the default is that of the paper's figure 3."""


@dataclass(frozen=True)
class Shot:
    """One roll-out to show."""

    name: str
    code: jax.Array  # [code]


def main(words: list[str]) -> None:
    command = parse(RenderCommand, words, "render")
    _check(command)
    trained = command.load()
    program, policy = trained.program, policy_of(trained, command.policy)
    shots = _shots(command, trained, policy)
    with phase("rolling out"):
        codes = jnp.stack([shot.code for shot in shots])
        trajectories = follow(program, policy, codes, command.steps, jax.random.key(command.seed))
    name = _file_name(command, shots)
    files = _draw(trained.directory, name, program.family, shots, trajectories, command.film)
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
    check_finite("--beta", *command.beta)


def _shots(command: RenderCommand, trained: Trained, policy: Params) -> list[Shot]:
    """Returns the roll-outs to show, in their order."""
    program, agent, tasks = trained.program, trained.program.agent, trained.program.tasks
    table = agent.codes(policy)

    def row(name: str) -> int:
        return tasks.index(find_task(program.family, name).name)

    if command.task:
        return [Shot(tasks.names[index], table[index]) for index in map(row, command.task)]
    if command.lte:
        codes = ltes.find(trained.directory, command.lte, program.config.seeds, agent.code_size, trained.fingerprint)
        return [Shot("LTE " + " ".join(command.lte), agent.project(jnp.array(codes[command.policy])))]
    first, second = map(row, command.interpolate or ())
    if first == second:
        raise UsageError(f"--interpolate {' '.join(command.interpolate or ())} names one task twice")
    betas = sorted(command.beta or BETAS, reverse=True)
    blended = blend_codes(agent, table[first], table[second], betas, command.along)
    blends = [Shot(f"β = {beta:g}", code) for beta, code in zip(betas, blended, strict=True)]
    return [Shot(tasks.names[first], table[first]), *blends, Shot(tasks.names[second], table[second])]


def _file_name(command: RenderCommand, shots: list[Shot]) -> str:
    names = [shot.name for shot in shots]
    name = f"{names[0]}_to_{names[-1]}" if command.interpolate else "_".join(names)
    return re.sub(r"[^\w.-]+", "_", name)


def _draw(
    run: Path, name: str, family: Family, shots: list[Shot], trajectories: list[Trajectory], with_film: bool
) -> dict[str, Path]:
    """Writes the strip and the films; without OpenGL it draws the strip as stick figures and raises RunError."""
    figures = records.folder(run / "figures")
    labels = [_label(family, *pair) for pair in zip(shots, trajectories, strict=True)]
    strip = arrange(family.portrait(), trajectories, labels, family.dt)
    path = figures / f"strip_{name}.png"
    try:
        with phase("drawing the strip"):
            draw_strip(path, photograph(strip), strip.bounds, strip.caption)
        if not with_film:
            return {"strip": path}
        with phase("filming"):
            pictures, seconds = film(strip.model, trajectories, [shot.name for shot in shots], family.dt)
    except RunError as error:
        draw_strip(path, strip.panels, strip.bounds, strip.caption)
        raise RunError(f"{error}; {path} shows stick figures instead, and there is no film") from None
    videos = records.folder(run / "videos")
    files = {"strip": path, "gif": write_gif(videos / f"{name}.gif", pictures, seconds)}
    mp4 = write_mp4(videos / f"{name}.mp4", pictures, seconds)
    if mp4:
        return {**files, "mp4": mp4}
    say("no MP4: ffmpeg is not on the PATH")
    return files


def _label(family: Family, shot: Shot, trajectory: Trajectory) -> str:
    fell = "\nfell" if trajectory.fell else ""
    return f"{textwrap.fill(shot.name, 16)}\n{trajectory.achieved:z.2f} {family.unit}{fell}"
