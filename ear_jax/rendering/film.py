"""Pictures of trajectories: films that follow the robot, and stop-motion strips."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from matplotlib.colors import to_rgb

from ear_jax.embeddings.trajectory import Trajectory
from ear_jax.figures.strip import GROUND, TALLEST, Bounds, Panel, Track
from ear_jax.figures.style import COLOURS
from ear_jax.figures.video import caption
from ear_jax.rendering.scene import (
    Canvas,
    Limbs,
    Locomotion,
    camera_at,
    camera_without_perspective,
    limbs,
    locomotion_of,
    project,
)

WIDTH, HEIGHT, ROW_HEIGHT = 480, 270, 160  # pixels of a film, and of each row if there are several
FIELD_OF_VIEW = 45.0  # degrees, from top to bottom
FRAME_SECONDS = 0.04  # per picture of a film, unless an environment step is longer
SPACING = 1.4  # robot lengths from one pose of a strip to the next, at the median speed of its tracks
MAX_WIDTH = 12  # width of a strip in robot sizes, unless its flags are further apart
MIN_ASPECT = 3.0  # least ratio of width to height of a panel, if the robot runs along x
MARGIN = 0.25  # margin around the poses in robot sizes
POLE = 0.7  # height of a flag in robot lengths, if the robot roams
PALE = 0.6  # share of the ground colour in the first pose of a strip, which fades to 0 in the last
# Elevation of the camera, radians.
STRIP_ELEVATION: dict[Locomotion, float] = {
    "runs": math.radians(12),
    "roams": math.radians(50),
    "fixed": math.radians(15),
}
FILM_ELEVATION: dict[Locomotion, float] = {**STRIP_ELEVATION, "roams": math.radians(25)}


def film(
    model: mujoco.MjModel, trajectories: Sequence[Trajectory], names: Sequence[str], dt: float
) -> tuple[list[np.ndarray], float]:
    """Films trajectories with a camera that follows the robot from its side, one row per trajectory.

    Args:
      model: the robot.
      trajectories: the trajectories; one that ends early is shown in its last pose until the longest ends.
      names: the captions of the trajectories.
      dt: seconds in one environment step.

    Returns:
      The pictures [height, width, 3], and the seconds from one to the next.

    Raises:
      RunError: there is no OpenGL that renders off screen.
    """
    width, height = WIDTH, HEIGHT if len(trajectories) == 1 else ROW_HEIGHT
    robots = [limbs(model, trajectory.qpos) for trajectory in trajectories]
    length, top = max(robot.length for robot in robots), max(robot.top for robot in robots)
    high = max(1.5 * top, 2.2 * length * height / width)  # metres from bottom to top of a picture
    distance = high / (2 * math.tan(math.radians(FIELD_OF_VIEW) / 2))
    locomotion = locomotion_of(model)

    def picture(canvas: Canvas, row: int, moment: int) -> np.ndarray:
        last = len(trajectories[row].qpos) - 1
        step, centres = min(moment, last), robots[row].centres
        x, y, _ = centres[0 if locomotion == "fixed" else step]
        travelled = "" if locomotion == "fixed" else f" · {np.linalg.norm((centres[step] - centres[0])[:2]):.1f} m"
        fell = " · fell" if trajectories[row].fell and moment >= last else ""
        camera = camera_at((x, y, top / 2), distance, FILM_ELEVATION[locomotion])
        drawn = canvas.draw(trajectories[row].qpos[[step]], camera, FIELD_OF_VIEW)
        return caption(drawn, f"{names[row]} · {step * dt:.2f} s{travelled}{fell}")

    every = max(1, round(FRAME_SECONDS / dt))
    moments = range(0, max(len(trajectory.qpos) for trajectory in trajectories), every)
    with Canvas(model, width, height) as canvas:
        rows = range(len(trajectories))
        return [np.concatenate([picture(canvas, row, moment) for row in rows]) for moment in moments], every * dt


@dataclass(frozen=True)
class Strip:
    """The contents of a stop-motion strip, before it is drawn."""

    model: mujoco.MjModel
    tracks: tuple[Track, ...]
    poses: tuple[np.ndarray, ...]  # [poses, nq] of each track
    bounds: Bounds
    seconds: float  # from one pose to the next

    @property
    def together(self) -> bool:
        """True if one panel shows all tracks, as roaming robots part in it."""
        return locomotion_of(self.model) == "roams"

    @property
    def beside(self) -> bool:
        """True if panels stand side by side, as robots that stay where they are need no width."""
        return locomotion_of(self.model) == "fixed"

    @property
    def caption(self) -> str:
        """The label of the axis, with the time between poses."""
        if locomotion_of(self.model) == "fixed":
            return "across (m), last pose of each"
        if all(len(poses) == 1 for poses in self.poses):
            return "x (m), last pose of each"
        return f"x (m), a pose every {self.seconds:.4g} s"

    @property
    def panels(self) -> list[Panel]:
        """One panel per track, or one for all."""
        return [Panel(self.tracks)] if self.together else [Panel((track,)) for track in self.tracks]


def arrange(model: mujoco.MjModel, trajectories: Sequence[Trajectory], labels: Sequence[str], dt: float) -> Strip:
    """Chooses the part of the plane that a strip shows, and the poses.

    Args:
      model: the robot.
      trajectories: one for each track.
      labels: the labels of the tracks.
      dt: seconds in one environment step.
    """
    locomotion = locomotion_of(model)
    elevation = STRIP_ELEVATION[locomotion]
    robots = [limbs(model, trajectory.qpos) for trajectory in trajectories]
    bounds = _bounds(robots, elevation, locomotion)
    length = max(robot.length for robot in robots)
    every, goes = _steps_between(robots, length), _ways(robots) > length

    def track(row: int, robot: Limbs) -> tuple[Track, np.ndarray]:
        shown = project(robot.ends, elevation)
        inside = (shown[..., 0].min((1, 2)) > bounds.left) & (shown[..., 0].max((1, 2)) < bounds.right)
        moments = np.arange(len(inside))[::-every][::-1]
        moments = moments[inside[moments]] if goes[row] and locomotion != "fixed" else moments[-1:]
        x, foot = project(robot.centres[-1] * (1, 1, 0), elevation)
        pole = POLE * length if locomotion == "roams" else 0.95 * bounds.high
        flag = None if locomotion == "fixed" else (float(x), float(foot), pole)
        colours = _fading(COLOURS[0 if locomotion == "runs" else row % len(COLOURS)], len(moments))
        return Track(labels[row], colours, shown[moments], robot.radii, flag), trajectories[row].qpos[moments]

    tracks, poses = zip(*(track(row, robot) for row, robot in enumerate(robots)), strict=True)
    return Strip(model, tracks, poses, bounds, every * dt)


def _ways(robots: Sequence[Limbs]) -> np.ndarray:
    """Returns the distance from start to end of each robot, [robots] metres."""
    return np.array([np.linalg.norm((robot.centres[-1] - robot.centres[0])[:2]) for robot in robots])


def _steps_between(robots: Sequence[Limbs], length: float) -> int:
    """Returns the environment steps from one pose to the next, so that no pose of a track covers the one before it.

    The median of the robots that go anywhere decides, unless a slower one would cover its own poses.
    """
    ways, counts = _ways(robots), np.array([len(robot.ends) for robot in robots])
    paces = (ways / counts)[ways > length]  # metres per environment step
    if not len(paces):
        return int(counts.max())
    return math.ceil(max(SPACING * length / float(np.median(paces)), length / float(paces.min())))


def photograph(strip: Strip) -> list[Panel]:
    """Renders the pictures of a strip's panels; raises RunError if there is no OpenGL that renders off screen."""
    bounds, together = strip.bounds, strip.together
    camera = camera_without_perspective(bounds, STRIP_ELEVATION[locomotion_of(strip.model)])
    # Colours distinguish robots that share a picture; a robot alone in its picture keeps its own colour and only fades.
    colours = [track.colours if together else _fading(GROUND, len(track.colours)) for track in strip.tracks]
    share = [np.full(len(rows), 0.85) if together else np.linspace(0, PALE, len(rows))[::-1] for rows in colours]
    tints = [np.column_stack([rows, weight]) for rows, weight in zip(colours, share, strict=True)]
    poses = list(strip.poses)
    if together:
        poses, tints = [np.concatenate(poses)], [np.concatenate(tints)]
    with Canvas(strip.model, *bounds.pixels) as canvas:
        high = bounds.high - bounds.low
        pictures = [canvas.draw(shown, camera, high, tint) for shown, tint in zip(poses, tints, strict=True)]
    return [replace(panel, picture=picture) for panel, picture in zip(strip.panels, pictures, strict=True)]


def _bounds(robots: Sequence[Limbs], elevation: float, locomotion: Locomotion) -> Bounds:
    """Chooses the part of the plane that a strip shows: all poses, or only the end of a long run along x."""
    size = max(max(robot.length, robot.top) for robot in robots)
    points = np.concatenate([project(robot.ends, elevation).reshape(-1, 2) for robot in robots])
    (left, low), (right, high) = (map(float, corner) for corner in (points.min(0), points.max(0)))
    if locomotion == "roams":
        high = max(high, *(float(project(robot.centres[-1], elevation)[1]) + POLE * size for robot in robots))
    elif locomotion == "runs":
        low = 0.0  # the ground, up to its visible edge
        lasts = [robot.ends[-1, ..., 0] for robot in robots]
        room = max(MAX_WIDTH * size, float(np.ptp(lasts)) + 2 * size)
        if sum(robot.centres[-1, 0] - robot.centres[0, 0] for robot in robots) >= 0:
            left = max(left, right - room)
        else:
            right = min(right, left + room)
    left, right, low, high = left - MARGIN * size, right + MARGIN * size, low - MARGIN * size, high + MARGIN * size
    missing = max(0.0, (MIN_ASPECT if locomotion == "runs" else 1.0) * (high - low) - (right - left))
    ground, tallest = (0.0, TALLEST) if locomotion == "runs" else (high, TALLEST / (1 + (locomotion == "fixed")))
    return Bounds(left - missing / 2, right + missing / 2, low, high, ground, tallest)


def _fading(colour: str, count: int) -> np.ndarray:
    """Returns `count` shades [count, 3] of a colour, from pale to full."""
    pale = np.linspace(0, PALE, count)[::-1, None]
    return pale * to_rgb(GROUND) + (1 - pale) * to_rgb(colour)
