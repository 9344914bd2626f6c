"""Pictures of trajectories: films that follow the robot, and stop-motion strips of its whole way."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from matplotlib.colors import to_rgb

from ear_jax.embeddings.trajectory import Trajectory
from ear_jax.figures.strip import GROUND, Bounds, Panel, Track
from ear_jax.figures.style import COLOURS
from ear_jax.figures.video import caption
from ear_jax.rendering.scene import Canvas, Limbs, Way, camera_at, camera_without_perspective, limbs, project, way_of

WIDTH, HEIGHT, ROW_HEIGHT = 480, 270, 160  # pixels of a film, and of each of its rows where there are several
FIELD_OF_VIEW = 45.0  # degrees, from top to bottom
FRAME_SECONDS = 0.04  # of a film, unless an environment step is longer
SPACING = 1.4  # robot lengths from one pose of a strip to the next, at the middle one of its speeds
LONGEST = 12  # robot sizes a strip shows, unless its flags stand further apart
SQUATTEST = 3.0  # a panel is at least so many times as wide as it is high, where the robot runs along x
MARGIN = 0.25  # robot sizes around what is shown
POLE = 0.7  # robot lengths, of a flag among robots that roam
PALE = 0.6  # how far the first pose of a strip has faded
# From how high a robot is seen, in radians.
STRIP_ELEVATION: dict[Way, float] = {"runs": math.radians(12), "roams": math.radians(50), "stands": math.radians(15)}
FILM_ELEVATION: dict[Way, float] = {**STRIP_ELEVATION, "roams": math.radians(25)}


def film(
    model: mujoco.MjModel, trajectories: Sequence[Trajectory], names: Sequence[str], dt: float
) -> tuple[list[np.ndarray], float]:
    """Follows the robot with a camera at its side, one row a trajectory.

    Args:
      model: the robot.
      trajectories: where it went; one that ends early stands still until the longest ends.
      names: what to call each.
      dt: seconds in one environment step.

    Returns:
      A picture [height, width, 3] for every moment, and the seconds from one to the next.

    Raises:
      RunError: no OpenGL that draws off the screen.
    """
    width, height = WIDTH, HEIGHT if len(trajectories) == 1 else ROW_HEIGHT
    seen = [limbs(model, trajectory.qpos) for trajectory in trajectories]
    length, top = max(one.length for one in seen), max(one.top for one in seen)
    high = max(1.5 * top, 2.2 * length * height / width)  # metres, from the picture's bottom to its top
    distance = high / (2 * math.tan(math.radians(FIELD_OF_VIEW) / 2))
    way = way_of(model)

    def picture(canvas: Canvas, row: int, moment: int) -> np.ndarray:
        last = len(trajectories[row].qpos) - 1
        here = min(moment, last)
        x, y, _ = seen[row].centres[0 if way == "stands" else here]
        away = np.linalg.norm((seen[row].centres[here] - seen[row].centres[0])[:2])
        gone = "" if way == "stands" else f" · {away:.1f} m"
        fell = " · fell" if trajectories[row].fell and moment >= last else ""
        camera = camera_at((x, y, top / 2), distance, FILM_ELEVATION[way])
        drawn = canvas.draw(trajectories[row].qpos[[here]], camera, FIELD_OF_VIEW)
        return caption(drawn, f"{names[row]} · {here * dt:.2f} s{gone}{fell}")

    every = max(1, round(FRAME_SECONDS / dt))
    moments = range(0, max(len(trajectory.qpos) for trajectory in trajectories), every)
    with Canvas(model, width, height) as canvas:
        rows = range(len(trajectories))
        return [np.concatenate([picture(canvas, row, moment) for row in rows]) for moment in moments], every * dt


@dataclass(frozen=True)
class Strip:
    """What a stop-motion strip shows, before it is drawn."""

    model: mujoco.MjModel
    tracks: tuple[Track, ...]
    poses: tuple[np.ndarray, ...]  # [poses, nq], a track each
    bounds: Bounds
    seconds: float  # from one pose to the next

    @property
    def together(self) -> bool:
        """Whether one panel shows all: robots that roam part in it, and those that stand need no more."""
        return way_of(self.model) != "runs"

    @property
    def caption(self) -> str:
        """What the axis shows, and what a reader has to know beside."""
        if way_of(self.model) == "stands":
            return "across (m), where each ended"
        return f"x (m), a pose every {self.seconds:.4g} s"

    @property
    def panels(self) -> list[Panel]:
        """A panel a track, or one for all."""
        return [Panel(self.tracks)] if self.together else [Panel((track,)) for track in self.tracks]


def arrange(model: mujoco.MjModel, trajectories: Sequence[Trajectory], labels: Sequence[str], dt: float) -> Strip:
    """Chooses what of the track a strip shows, and which poses.

    Args:
      model: the robot.
      trajectories: where it went.
      labels: what to call each.
      dt: seconds in one environment step.
    """
    way, elevation = way_of(model), STRIP_ELEVATION[way_of(model)]
    seen = [limbs(model, trajectory.qpos) for trajectory in trajectories]
    bounds = _bounds(seen, elevation, way)
    length, steps = max(one.length for one in seen), max(len(one.ends) - 1 for one in seen)
    pace = np.median([np.linalg.norm((one.centres[-1] - one.centres[0])[:2]) / len(one.ends) for one in seen])
    every = int(np.clip(math.ceil(SPACING * length / max(pace, 1e-9)), 1, max(steps // 3, 1)))

    def track(row: int, one: Limbs) -> tuple[Track, np.ndarray]:
        shown = project(one.ends, elevation)
        inside = (shown[..., 0].min((1, 2)) > bounds.left) & (shown[..., 0].max((1, 2)) < bounds.right)
        moments = np.arange(len(inside))[::-every][::-1]
        moments = moments[-1:] if way == "stands" else moments[inside[moments]]
        x, foot = project(one.centres[-1] * (1, 1, 0), elevation)
        pole = POLE * length if way == "roams" else 0.95 * bounds.high
        flag = None if way == "stands" else (float(x), float(foot), pole)
        colours = _fading(COLOURS[0 if way == "runs" else row % len(COLOURS)], len(moments))
        return Track(labels[row], colours, shown[moments], one.radii, flag), trajectories[row].qpos[moments]

    tracks, poses = zip(*(track(row, one) for row, one in enumerate(seen)), strict=True)
    return Strip(model, tracks, poses, bounds, every * dt)


def photograph(strip: Strip) -> list[Panel]:
    """The strip's panels with their pictures; raises RunError where there is no OpenGL that draws off the screen."""
    bounds, together = strip.bounds, strip.together
    camera = camera_without_perspective(bounds, STRIP_ELEVATION[way_of(strip.model)])
    # Robots that share a picture are told apart by colour; one alone keeps its own and only fades.
    colours = [track.colours if together else _fading(GROUND, len(track.colours)) for track in strip.tracks]
    share = [np.full(len(rows), 0.85) if together else np.linspace(PALE, 0, len(rows)) for rows in colours]
    tints = [np.column_stack([rows, weight]) for rows, weight in zip(colours, share, strict=True)]
    poses = list(strip.poses)
    if together:
        poses, tints = [np.concatenate(poses)], [np.concatenate(tints)]
    with Canvas(strip.model, *bounds.pixels) as canvas:
        high = bounds.high - bounds.low
        pictures = [canvas.draw(shown, camera, high, tint) for shown, tint in zip(poses, tints, strict=True)]
    return [replace(panel, picture=picture) for panel, picture in zip(strip.panels, pictures, strict=True)]


def _bounds(seen: Sequence[Limbs], elevation: float, way: Way) -> Bounds:
    """What a strip shows: all of the way, but of a long one along x only the part in which it ends."""
    size = max(max(one.length, one.top) for one in seen)
    points = np.concatenate([project(one.ends, elevation).reshape(-1, 2) for one in seen])
    (left, low), (right, high) = (map(float, corner) for corner in (points.min(0), points.max(0)))
    if way == "roams":
        high = max(high, *(float(project(one.centres[-1], elevation)[1]) + POLE * size for one in seen))
    elif way == "runs":
        low = 0.0  # the ground, whose edge is in sight
        lasts = [one.ends[-1, ..., 0] for one in seen]
        room = max(LONGEST * size, float(np.ptp(lasts)) + 2 * size)
        if sum(one.centres[-1, 0] - one.centres[0, 0] for one in seen) >= 0:
            left = max(left, right - room)
        else:
            right = min(right, left + room)
    left, right, low, high = left - MARGIN * size, right + MARGIN * size, low - MARGIN * size, high + MARGIN * size
    missing = max(0.0, (SQUATTEST if way == "runs" else 1.0) * (high - low) - (right - left))
    return Bounds(left - missing / 2, right + missing / 2, low, high, 0.0 if way == "runs" else high)


def _fading(colour: str, count: int) -> np.ndarray:
    """`count` shades [count, 3] of a colour, from pale to full."""
    pale = np.linspace(0, PALE, count)[::-1, None]
    return pale * to_rgb(GROUND) + (1 - pale) * to_rgb(colour)
