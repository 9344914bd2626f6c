"""Courses to follow, a profile of the commanded quantity over time or way-points on the floor, and errors in it."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from ear_jax.embeddings.survey import Survey
from ear_jax.envs import Family
from ear_jax.envs.family import Outcome
from ear_jax.errors import UsageError

SETTLING = 1.0  # seconds at the start that the error of a profile leaves out, while the robot gets going
PACE = 0.7  # of the usual speed, along a path: a robot at full speed turns wide
SLACK = 2.0  # time for a path, in the time that its length takes at that pace
LONGEST = 60.0  # seconds


@dataclass(frozen=True)
class Course:
    """A course to be followed, with its duration."""

    outcomes: tuple[str, ...]  # the commanded outcome, or the two of the velocity on the floor
    unit: str  # of the error
    times: np.ndarray  # [points] seconds; of a path, when it would get there at its speed
    points: np.ndarray  # [points, 1] values, or [points, 2] metres from the start on
    wanted: np.ndarray  # [steps, 1] values, or [steps, 2] the velocity on the way
    is_path: bool

    @property
    def ends(self) -> np.ndarray:
        """The start and the way-points of a path, [points + 1, 2] metres."""
        return np.concatenate([np.zeros((1, 2)), self.points])

    def error(self, outcome: Outcome, playing: jax.Array, dt: float) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Returns the error of one roll-out, its cost, and the number of steps until it has followed the course.

        The error of a profile is the root mean square from `SETTLING` on, and its cost adds the first second. The error
        of a path is the largest distance from a way-point: way-points count in their order, each when the robot is
        nearest. Its cost is the largest distance from the straight lines between them, up to the last way-point, where
        it ends.

        Args:
          outcome: by name, each [steps].
          playing: bool [steps]; a robot that has failed stays where it is.
          dt: seconds in a step.
        """
        followed = jnp.stack([jnp.where(playing, outcome[name], 0.0) for name in self.outcomes], axis=-1)
        if self.is_path:
            places = jnp.cumsum(followed, axis=0) * dt
            misses, moments = self._misses(places)
            aside = jnp.where(jnp.arange(len(places)) <= moments[-1], self._aside(places), 0.0)
            return jnp.sqrt(misses.max()), jnp.sqrt(aside.max()), moments[-1] + 1
        squared = jnp.sum((followed - self.wanted) ** 2, axis=-1)
        return jnp.sqrt(jnp.mean(squared[round(SETTLING / dt) :])), jnp.mean(squared), jnp.int32(len(squared))

    @property
    def speed(self) -> float:
        """Speed on a path in m/s."""
        return float(np.linalg.norm(self.wanted[0]))

    def _misses(self, places: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Returns the squared distance [points] of each way-point from the robot's places [steps, 2], and the step.

        The moments at which it is there are in the order of the way-points, and such that the sum is least.
        """
        apart = jnp.sum((places[:, None] - self.points) ** 2, axis=-1).T  # [points, steps]

        def reach(before: jax.Array, here: jax.Array) -> tuple[jax.Array, jax.Array]:
            total = here + jax.lax.cummin(before)
            return total, total

        sums = jax.lax.scan(reach, jnp.zeros(len(places)), apart)[1]  # least sum up to a way-point met at a step

        def trace(last: jax.Array, row: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
            total, here = row
            moment = jnp.argmin(jnp.where(jnp.arange(len(total)) <= last, total, jnp.inf))
            return moment, (here[moment], moment)

        return jax.lax.scan(trace, jnp.array(len(places)), (sums, apart), reverse=True)[1]

    def _aside(self, places: jax.Array) -> jax.Array:
        """Returns the squared distance of places [steps, 2] from the lines between way-points, [steps]."""
        begin, along = self.ends[:-1], np.diff(self.ends, axis=0)
        share = jnp.sum((places[:, None] - begin) * along, -1) / (along**2).sum(axis=-1)
        nearest = begin + jnp.clip(share, 0, 1)[..., None] * along
        return jnp.sum((places[:, None] - nearest) ** 2, axis=-1).min(axis=1)


def course_of(family: Family, profile: str | None, path: str | None, survey: Survey | None = None) -> Course:
    """Returns the course of a profile or else of a path.

    The speed on a path is `PACE` of the usual one, the median of a survey's under LTEs whose episodes last; without a
    survey it is 1 m/s, and a path of any length is a course.

    Raises:
      UsageError: as `profile_course` and `path_course`, or no surveyed LTE lasts an episode.
    """
    if profile is not None:
        return profile_course(family, profile)
    speed = None
    if survey and family.plane:
        late = [survey.outcomes[name][..., survey.steps // 2 :].mean(axis=-1) for name in family.plane]
        lasting = survey.lengths == survey.steps
        if not lasting.any():
            raise UsageError("under no surveyed LTE does the robot last an episode, so it cannot follow a path")
        speed = PACE * float(np.median(np.hypot(*late)[lasting]))
    return path_course(family, path or "", speed)


def profile_course(family: Family, text: str) -> Course:
    """Returns the course of a profile such as `0:1, 3:6, 6:2`: seconds and values, with straight lines between them.

    Raises:
      UsageError: it is no profile, its times do not begin at 0 and rise, or the family commands no outcome.
    """
    if family.commanded not in family.outcome_shapes:
        raise UsageError(f"{family.name} commands no outcome of a step to follow; {_instead(family)}")
    pairs = [_numbers(part, ":", "--profile", "seconds:value, as in 0:1, 3:6, 6:2") for part in _parts(text)]
    times, values = np.array(pairs, float).reshape(-1, 2).T
    if len(times) < 2 or times[0] != 0 or (np.diff(times) <= 0).any():
        raise UsageError(f"--profile {text!r} must begin at 0 seconds and go on to later ones, as in 0:1, 3:6, 6:2")
    _check_length(times[-1], "--profile")
    moments = family.dt * np.arange(1, round(times[-1] / family.dt) + 1)
    wanted = np.interp(moments, times, values)[:, None]
    return Course((family.commanded,), family.unit, times, values[:, None], wanted, False)


def path_course(family: Family, text: str, at_speed: float | None) -> Course:
    """Returns the course of way-points such as `6 0, 6 6, 0 6, 0 0`, in metres from the start, at a speed in m/s.

    Raises:
      UsageError: they are no way-points, or the robot does not roam on the floor.
    """
    if family.plane is None:
        raise UsageError(f"{family.name} does not move freely on the floor; {_instead(family)}")
    points = np.array([_numbers(part, None, "--path", "x y, as in 6 0, 6 6") for part in _parts(text)], float)
    ends = np.concatenate([np.zeros((1, 2)), points])
    lengths = np.linalg.norm(np.diff(ends, axis=0), axis=1)
    if not (lengths > 0).all():
        raise UsageError(f"--path {text!r} names a point twice in a row, or begins with the start, 0 0")
    speed = at_speed or 1.0
    times = np.cumsum(lengths) / speed
    if at_speed:
        _check_length(SLACK * times[-1], "--path")
    moments = family.dt * np.arange(1, round(SLACK * times[-1] / family.dt) + 1)
    row = np.minimum(np.searchsorted(times, moments), len(points) - 1)
    wanted = speed * (np.diff(ends, axis=0) / lengths[:, None])[row]
    return Course(family.plane, "m", times, points, wanted, True)


def _instead(family: Family) -> str:
    """Returns the words for what a family can follow."""
    if family.plane:
        return "give way-points with --path"
    return "give --profile" if family.commanded in family.outcome_shapes else "its tasks are met with `ear adapt`"


def _parts(text: str) -> list[str]:
    return [part.strip() for part in text.split(",")]


def _numbers(part: str, mark: str | None, option: str, wanted: str) -> list[float]:
    """Reads two finite numbers, with a mark or blanks between them."""
    words = re.split(r"\s*:\s*", part) if mark else part.split()
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        numbers = []
    if len(numbers) != 2 or not all(map(math.isfinite, numbers)):
        raise UsageError(f"{option}: {part!r} is not {wanted}")
    return numbers


def _check_length(seconds: float, option: str) -> None:
    if not 2 * SETTLING <= seconds <= LONGEST:
        raise UsageError(f"{option} takes {seconds:.3g} s; it must be from {2 * SETTLING:g} to {LONGEST:g}")
