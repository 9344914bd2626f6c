"""The roll-outs that `ear render` shows, and the files it makes of them."""

from __future__ import annotations

import re
import textwrap
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp

from ear_jax.agents.networks import Params
from ear_jax.cli.ends import find_end
from ear_jax.cli.results import LONGEST, short_hash
from ear_jax.embeddings import ltes
from ear_jax.embeddings.interpolate import blend_codes
from ear_jax.embeddings.trajectory import Trajectory
from ear_jax.envs import Family, find_task
from ear_jax.errors import RunError, UsageError
from ear_jax.figures.strip import draw_strip
from ear_jax.figures.video import write_gif, write_mp4
from ear_jax.process.terminal import phase, say
from ear_jax.rendering.film import arrange, film, photograph
from ear_jax.runs import records
from ear_jax.runs.trained import Trained

BETAS = (0.75, 0.5, 0.25)


@dataclass(frozen=True)
class Shot:
    """One roll-out to show."""

    name: str
    code: jax.Array  # [code]


def choose_shots(command: Any, trained: Trained, policy: Params) -> list[Shot]:
    """Returns the roll-outs that the options of `ear render` ask for, in their order."""
    program, agent, tasks = trained.program, trained.program.agent, trained.program.tasks
    if command.task:
        table, rows = agent.codes(policy), [tasks.index(find_task(program.family, name).name) for name in command.task]
        return [Shot(tasks.names[row], table[row]) for row in rows]
    if command.lte:
        codes = ltes.find(trained.directory, command.lte, program.config.seeds, agent.code_size, trained.fingerprint)
        return [Shot("LTE " + " ".join(command.lte), agent.project(jnp.array(codes[command.policy])))]
    ends = [find_end(trained, word) for word in command.interpolate]
    if ends[0].name == ends[1].name:
        raise UsageError(f"--interpolate {' '.join(command.interpolate)} names one task twice")
    first, second = (Shot(end.name, jnp.array(end.codes[command.policy])) for end in ends)
    betas = sorted(command.beta or BETAS, reverse=True)
    blended = blend_codes(agent, first.code, second.code, betas, command.along)
    return [first, *(Shot(f"β = {beta:g}", code) for beta, code in zip(betas, blended, strict=True)), second]


def file_name(command: Any, shots: list[Shot]) -> str:
    names = [shot.name for shot in shots]
    name = f"{names[0]}_to_{names[-1]}" if command.interpolate else "_".join(names)
    safe = re.sub(r"[^\w.-]+", "_", name)
    return safe if len(safe) <= LONGEST else f"{safe[:LONGEST]}-{short_hash(name)}"


def draw(
    run: Path,
    name: str,
    family: Family,
    names: list[str],
    trajectories: list[Trajectory],
    with_film: bool,
    said: list[str] | None = None,
) -> dict[str, Path]:
    """Writes the strip and the films; without OpenGL it draws the strip as stick figures and raises RunError.

    Args:
      run: the directory in whose folders they are written.
      name: part of the files' names.
      family: the robot's.
      names: of the trajectories.
      trajectories: what the robots did.
      with_film: False for a strip alone.
      said: words below each name in the strip; by default what the robot achieved.

    Returns:
      The paths of `strip`, `gif` and `mp4`.
    """
    figures = records.folder(run / "figures")
    said = said or [f"{one.achieved:z.2f} {family.unit}" for one in trajectories]
    labels = [_label(*one) for one in zip(names, said, trajectories, strict=True)]
    strip = arrange(family.portrait(), trajectories, labels, family.dt)
    path = figures / f"strip_{name}.png"
    try:
        with phase("drawing the strip"):
            draw_strip(path, photograph(strip), strip.bounds, strip.caption, strip.beside)
        if not with_film:
            return {"strip": path}
        with phase("filming"):
            pictures, seconds = film(strip.model, trajectories, names, family.dt)
    except RunError as error:
        draw_strip(path, strip.panels, strip.bounds, strip.caption, strip.beside)
        raise RunError(f"{error}; {path} shows stick figures instead, and there is no film") from None
    videos = records.folder(run / "videos")
    files = {"strip": path, "gif": write_gif(videos / f"{name}.gif", pictures, seconds)}
    mp4 = write_mp4(videos / f"{name}.mp4", pictures, seconds)
    if mp4:
        return {**files, "mp4": mp4}
    say("no MP4: ffmpeg is not on the PATH")
    return files


def _label(name: str, said: str, trajectory: Trajectory) -> str:
    fell = "\nfell" if trajectory.fell else ""
    return f"{textwrap.fill(name, 16)}\n{said}{fell}"
