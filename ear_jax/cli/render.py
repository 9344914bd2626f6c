"""`ear render RUN`."""

from __future__ import annotations

import json
import re
import textwrap
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import jax
import jax.numpy as jnp

from ear_jax.agents.networks import Params
from ear_jax.cli.arguments import check_finite, check_least, parse
from ear_jax.cli.on_run import OnPolicy
from ear_jax.embeddings import ltes
from ear_jax.embeddings.interpolate import between
from ear_jax.embeddings.trajectory import Trajectory, follow
from ear_jax.envs import Family, find_task
from ear_jax.errors import RunError, UsageError
from ear_jax.figures.strip import draw_strip
from ear_jax.figures.video import write_gif, write_mp4
from ear_jax.process.terminal import phase, say
from ear_jax.rendering.film import arrange, film, photograph
from ear_jax.runs import records
from ear_jax.runs.trained import Trained

BETAS = (0.75, 0.5, 0.25)


@dataclass(frozen=True, kw_only=True)
class RenderCommand(OnPolicy):
    """Show what the policy does under tasks it was trained on, under a code, or between two tasks."""

    task: tuple[str, ...] = ()
    """Tasks it was trained on, as in 2 or 1 2 3."""
    lte: tuple[str, ...] = ()
    """An LTE saved by `ear adapt --save`, or its numbers, as in 0.1 0.7 -0.7; they are taken to the sphere."""
    interpolate: tuple[str, str] | None = None
    """Two tasks, as in 1 2, and blends of them."""
    beta: tuple[float, ...] = ()
    """The blends, 0.75 0.5 0.25 if not given: 1 is the first task, 0 the second; outside [0, 1] they extrapolate."""
    along: Literal["chord", "arc"] = "chord"
    """The paper's normalised sum, or the great circle."""
    film: bool = True
    """GIF and MP4 beside the strip; --no-film leaves them out, which take most of the time."""
    steps: int = 100
    """Environment steps, as many as in the paper's figure 3."""


@dataclass(frozen=True)
class Shot:
    """One thing to show."""

    name: str
    code: jax.Array  # [code]


def main(words: list[str]) -> None:
    command = parse(RenderCommand, words, "render")
    _check(command)
    trained = command.load()
    program = trained.program
    policy = jax.tree.map(lambda leaf: leaf[command.policy], trained.policies)
    shots = _scenes(command, trained, policy)
    with phase("rolling out"):
        codes = jnp.stack([shot.code for shot in shots])
        trajectories = follow(program, policy, codes, command.steps, jax.random.key(command.seed))
    name = _file_name(command, shots)
    files = _draw(trained.directory, name, program.family, shots, trajectories, command.film)
    if not command.json:
        print("pictures: " + ", ".join(map(str, files.values())))
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
    """Refuses what makes no sense whatever the run."""
    if sum(map(bool, (command.task, command.lte, command.interpolate))) != 1:
        raise UsageError("say one of --task X, --lte x y z and --interpolate A B")
    if command.beta and not command.interpolate:
        raise UsageError("--beta goes with --interpolate A B alone")
    check_least(command, steps=1)
    check_finite("--beta", *command.beta)


def _scenes(command: RenderCommand, trained: Trained, policy: Params) -> list[Shot]:
    """What is asked for, in the order it is shown."""
    program, agent, tasks = trained.program, trained.program.agent, trained.program.tasks
    table = agent.codes(policy)

    def row(name: str) -> int:
        return tasks.index(find_task(program.family, name).name)

    if command.task:
        return [Shot(tasks.names[index], table[index]) for index in map(row, command.task)]
    if command.lte:
        codes = ltes.find(trained.directory, command.lte, program.config.seeds, agent.code_size, trained.fingerprint)
        return [Shot("LTE " + " ".join(command.lte), agent.project(jnp.array(codes[command.policy])))]
    one, other = map(row, command.interpolate or ())
    if one == other:
        raise UsageError(f"--interpolate {' '.join(command.interpolate or ())} names one task twice")

    way = between(agent, command.along)
    betas = sorted(command.beta or BETAS, reverse=True)
    blends = [Shot(f"β = {beta:g}", way(table[one], table[other], jnp.float32(beta))) for beta in betas]
    return [Shot(tasks.names[one], table[one]), *blends, Shot(tasks.names[other], table[other])]


def _file_name(command: RenderCommand, shots: list[Shot]) -> str:
    names = [shot.name for shot in shots]
    name = f"{names[0]}_to_{names[-1]}" if command.interpolate else "_".join(names)
    return re.sub(r"[^\w.-]+", "_", name)


def _draw(
    run: Path, name: str, family: Family, shots: list[Shot], trajectories: list[Trajectory], filmed: bool
) -> dict[str, Path]:
    """Writes strip and films; without OpenGL only the strip, as sticks, and then raises RunError."""
    figures = records.folder(run / "figures")
    labels = [_label(family, *pair) for pair in zip(shots, trajectories, strict=True)]
    strip = arrange(family.portrait(), trajectories, labels, family.dt)
    path = figures / f"strip_{name}.png"
    try:
        with phase("drawing the strip"):
            draw_strip(path, photograph(strip), strip.bounds, strip.caption)
        if not filmed:
            return {"strip": path}
        with phase("filming"):
            pictures, seconds = film(strip.model, trajectories, [shot.name for shot in shots], family.dt)
    except RunError as error:
        draw_strip(path, strip.panels, strip.bounds, strip.caption)
        raise RunError(f"{error}; without it there is {path}, and no film") from None
    videos = records.folder(run / "videos")
    files = {"strip": path, "gif": write_gif(videos / f"{name}.gif", pictures, seconds)}
    film_mp4 = write_mp4(videos / f"{name}.mp4", pictures, seconds)
    if film_mp4:
        return {**files, "mp4": film_mp4}
    say("no MP4: there is no ffmpeg on the PATH")
    return files


def _label(family: Family, shot: Shot, trajectory: Trajectory) -> str:
    fell = "\nfell" if trajectory.fell else ""
    return f"{textwrap.fill(shot.name, 16)}\n{trajectory.achieved:z.2f} {family.unit}{fell}"
