"""`ear follow RUN`."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from ear_jax.cli.arguments import check_finite, check_least, option, parse
from ear_jax.cli.on_run import OnRun
from ear_jax.cli.results import keep, label_of, print_pictures, print_table, show_and_keep
from ear_jax.errors import RunError, UsageError
from ear_jax.process.terminal import phase, say

if TYPE_CHECKING:
    from pathlib import Path

    from ear_jax.embeddings.course import Course
    from ear_jax.embeddings.survey import Survey
    from ear_jax.embeddings.trajectory import Trajectory
    from ear_jax.envs import Family
    from ear_jax.runs.trained import Trained


@dataclass(frozen=True, kw_only=True)
class FollowCommand(OnRun):
    """Follow a profile over time, or way-points on the floor, by task embeddings (LTEs) that change with time.

    For a profile a spline on the sphere is searched for; way-points are met by pursuit, which chooses the LTE from
    where the robot is. Beside either stands the plain look-up from a survey of the sphere.

    Example: ear follow pretrained:halfcheetah-vel --profile "0:1, 3:6, 6:2"
    """

    profile: Annotated[str | None, option("SECONDS:VALUE,...")] = None
    """The commanded quantity over time, with straight lines between the points, as in "0:1, 3:6, 6:2"."""
    path: Annotated[str | None, option("X Y,...")] = None
    """Way-points in metres from the start, as in "6 0, 6 6, 0 6, 0 0"."""
    every: float = 0.5
    """Seconds between the knots of a profile's spline."""
    epochs: int = 10
    """Epochs of the search for the spline."""
    candidates: int = 32
    """Splines tried in each epoch."""
    sigma: float = 0.2
    """Standard deviation of the knots' coordinates in the first epoch."""
    starts: int = 1
    """Random starts that each spline is played from."""
    episodes: int = 5
    """Fresh starts from which the result is played."""
    film: Annotated[bool, tyro.conf.arg(help_behavior_hint="")] = True
    """Leave out the films, and draw only the figure and the strip."""


def main(words: list[str]) -> None:
    command = parse(FollowCommand, words, "follow")
    _check(command)
    trained = command.load()
    from ear_jax.embeddings.course import course_of
    from ear_jax.embeddings.follow import SplineSearch, follow_course
    from ear_jax.embeddings.survey import PLACES, find_survey
    from ear_jax.figures.follow import draw_follow

    planned = course_of(trained.program.family, command.profile, command.path)  # refuses a mistake before the work
    dt, seconds = trained.program.family.dt, float(planned.times[-1])
    if not planned.is_path and not dt <= command.every <= seconds:
        raise UsageError(f"--every {command.every:g} is out of range; it must be from {dt:g} to {seconds:g} seconds")
    with phase("surveying the LTE sphere"):
        survey, env_steps = find_survey(trained, PLACES, 0)
    course = course_of(trained.program.family, command.profile, command.path, survey)
    if not course.is_path:
        _warn_beyond(survey, course, trained.program.family)
    search = SplineSearch(command.every, command.epochs, command.candidates, command.sigma, command.starts)
    searching = f"searching in {command.epochs} epochs of {command.candidates} splines"
    with phase("meeting way-points" if course.is_path else searching):
        document, trajectories = follow_course(trained, survey, course, search, command.episodes, command.seed)
    document["survey_env_steps"] = env_steps
    label = label_of(command)
    kept = partial(keep, trained.directory, "following", label, document, draw_follow)
    show_and_keep(document, command.json, _print, kept)
    try:
        files = _show(command, trained, document, trajectories, label)
    except RunError as error:
        say(f"warning: {error}")
    else:
        if not command.json:
            print_pictures(files)


def _check(command: FollowCommand) -> None:
    """Raises UsageError for options that are wrong for any run."""
    if (command.profile is None) == (command.path is None):
        raise UsageError("give one of --profile SECONDS:VALUE,... and --path X Y,...")
    check_least(command, epochs=1, candidates=2, starts=1, episodes=1)
    check_finite("--every", command.every)
    check_finite("--sigma", command.sigma)
    for name in ("every", "sigma"):
        if not getattr(command, name) > 0:
            raise UsageError(f"--{name} {getattr(command, name):g} is too small; it must be above 0")


def _warn_beyond(survey: Survey, course: Course, family: Family) -> None:
    """Warns of a profile that asks for more, or less, than the robot achieves under any surveyed LTE."""
    late = survey.outcomes[family.commanded][..., survey.steps // 2 :].mean(axis=-1)
    low, high = float(late.min()), float(late.max())
    asked = float(course.points.min()), float(course.points.max())
    margin = 0.05 * (high - low)
    if beyond := [value for value in asked if not low - margin <= value <= high + margin]:
        reached = f"{low:.2g} to {high:.2g} {family.unit}"
        say(f"warning: the profile asks for {beyond[-1]:g}; under its LTEs the robot achieves {reached}")


def _show(
    command: FollowCommand, trained: Trained, document: dict[str, Any], trajectories: dict[str, Trajectory], label: str
) -> list[Path]:
    """Draws the strip, and films the first seed's robot under both ways; returns the paths."""
    from ear_jax.cli.shots import draw

    names, shown = list(trajectories), list(trajectories.values())
    said = [f"{way['errors'][0]:.2f} {document['unit']} off" for way in document["seeds"][0]["ways"].values()]
    name, family = f"following{label}", trained.program.family
    return list(draw(trained.directory, name, family, names, shown, command.film, said).values())


def _print(document: dict[str, Any]) -> None:
    """Prints the error and the smoothness of both ways, and the costs."""
    unit = document["unit"]
    rows = [
        (str(entry["seed"]), name, *_errors(way), f"{way['turn']:.2f}")
        for entry in document["seeds"]
        for name, way in entry["ways"].items()
    ]
    aside = ("aside m>", "worst m>") if document["is_path"] else ()
    print_table(("seed", "way", f"error {unit}>", f"worst {unit}>", *aside, "turn rad/s>"), rows)
    meaning = "root mean square after the first second"
    if document["is_path"]:
        meaning = "largest distance from a way-point; aside: from the path"
    print(f"error: {meaning}; mean and worst of {document['episodes']} fresh starts; turn: how fast the LTE moves")
    searched = f"the search took {document['env_steps']:,} env steps and" if document["env_steps"] else "this took"
    print(f"{searched} {document['seconds']:.1f} s", end="")
    print(f", the survey {document['survey_env_steps']:,} env steps" if document["survey_env_steps"] else "")


def _errors(way: dict[str, Any]) -> list[str]:
    """Returns the mean and the worst error of a way, and of a path the mean and the largest distance from it too."""
    measured = [way[name] for name in ("errors", "aside") if name in way]
    return [f"{value:.2f}" for values in measured for value in (sum(values) / len(values), max(values))]
