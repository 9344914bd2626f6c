"""Progress on stderr: a live line on a terminal that can move its cursor, plain lines otherwise.

That nobody reads it stops nothing.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import Progress, ProgressColumn, SpinnerColumn, Task, TextColumn, TimeElapsedColumn
from rich.text import Text

from ear_jax.errors import plain
from ear_jax.process.progress import env_steps
from ear_jax.process.streams import Stderr, results_only

PERIOD = 600.0  # seconds over which the time left is estimated; blocks may take minutes

console = Console(file=Stderr(), highlight=False, markup=False, emoji=False)  # type: ignore[arg-type]


def say(line: str) -> None:
    """Prints a line, or several; control characters, which a terminal would obey, are spelt out."""
    console.print("\n".join(map(plain, line.splitlines())), soft_wrap=True)


def is_live() -> bool:
    """Returns whether stderr is a terminal that can move its cursor."""
    return console.is_terminal and not console.is_dumb_terminal


@contextmanager
def phase(name: str) -> Iterator[None]:
    """Shows a name and the time while something slow runs, then the seconds it took.

    What the slow work prints on stdout, as a user's family may, goes to stderr: stdout is for results.
    """
    began = time.perf_counter()
    if not is_live():
        say(f"{name} …")
    with _live(name), results_only():
        yield
    say(f"{name}: {time.perf_counter() - began:.1f} s")


@contextmanager
def sign_of_life(name: str) -> Iterator[None]:
    """Shows a name on a terminal while something slow runs, and nothing elsewhere; stdout as in `phase`."""
    if console.is_terminal and not is_live():
        say(f"{name} …")
    with _live(name), results_only():
        yield


def _live(name: str) -> Progress:
    """Returns a line that shows a name, the time that passes and the steps taken, and vanishes at the end."""
    columns = (SpinnerColumn(), TextColumn("{task.description}", markup=False), TimeElapsedColumn(), StepsColumn())
    line = Progress(*columns, console=console, transient=True, disable=not is_live(), redirect_stdout=False)
    line.add_task(plain(name), total=None, began=env_steps.taken)
    return line


class TrainingBar:
    """A progress bar of epochs, or of what else `unit` names, with the last block's return and speed."""

    def __init__(self, done: int, epochs: int, unit: str = "epoch"):
        columns = (SpinnerColumn(), BlockColumn())
        self._bar = Progress(
            *columns,
            console=console,
            speed_estimate_period=PERIOD,
            redirect_stdout=False,
            disable=not is_live(),
        )
        self._task = self._bar.add_task(unit, total=epochs, completed=done, mean_return=None, speed="")
        self._epochs, self._unit = epochs, unit

    def __enter__(self) -> TrainingBar:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def update(self, epoch: int, mean_return: float, env_steps_rate: float, updates_rate: float) -> None:
        """Shows a block's mean return and its environment steps and updates per second."""
        speed = f"{env_steps_rate:,.0f} steps/s · {updates_rate:,.0f} updates/s"
        self._bar.update(self._task, completed=epoch, mean_return=mean_return, speed=speed)
        if self._bar.disable:
            left = _clock(self._bar.tasks[0].time_remaining)
            say(f"{self._unit} {epoch}/{self._epochs} · return {mean_return:.1f} · {speed} · {left} left")


class StepsColumn(ProgressColumn):
    """Environment steps taken since the task began; only the native engine counts its steps."""

    def render(self, task: Task) -> Text:
        """Returns the count, or nothing while it is 0."""
        taken = env_steps.taken - task.fields["began"]
        return Text(f"{taken:,} env steps" if taken else "")


class BlockColumn(ProgressColumn):
    """Epochs, return and time left of a training run, and its speed where the terminal is wide enough."""

    def render(self, task: Task) -> Text:
        """Returns the longest form that fits beside the spinner."""
        done = f"{task.completed:.0f}/{task.total:.0f}"
        shown = task.fields["mean_return"]
        mean_return = [] if shown is None else [f"return {shown:.1f}"]
        left = f"{_clock(task.time_remaining)} left"
        speed = [task.fields["speed"]] if task.fields["speed"] else []
        forms = (
            [f"{task.description} {done}", *mean_return, *speed, _clock(task.elapsed), left],
            [f"{task.description} {done}", *mean_return, _clock(task.elapsed), left],
            [f"{task.description} {done}", *mean_return, left],
            [done, *(text.removeprefix("return ") for text in mean_return), left],
        )
        lines = [" · ".join(form) for form in forms]
        return Text(next((line for line in lines if len(line) <= console.width - 2), lines[-1]), no_wrap=True)


def _clock(seconds: float | None) -> str:
    """Returns a time as hours:minutes:seconds; dashes for an unknown one."""
    if seconds is None:
        return "-:--:--"
    minutes, rest = divmod(int(seconds), 60)
    return f"{minutes // 60}:{minutes % 60:02}:{rest:02}"
