"""Progress on stderr: a live line on a terminal, plain lines otherwise."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn

console = Console(stderr=True, highlight=False)


def say(line: str) -> None:
    """Prints one line."""
    console.print(line, markup=False, soft_wrap=True)


@contextmanager
def phase(name: str) -> Iterator[None]:
    """Shows a name while something slow runs, then the seconds it took."""
    began = time.perf_counter()
    with console.status(name):
        yield
    say(f"{name}: {time.perf_counter() - began:.1f} s")


class TrainingBar:
    """A progress bar of epochs with the last block's return and speed."""

    def __init__(self, done: int, epochs: int):
        self._plain = not console.is_terminal
        self._bar = Progress(
            SpinnerColumn(),
            TextColumn("epoch {task.completed:.0f}/{task.total:.0f}"),
            TextColumn("{task.description}"),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(elapsed_when_finished=False),
            console=console,
            disable=self._plain,
        )
        self._task = self._bar.add_task("training", total=epochs, completed=done)
        self._epochs = epochs

    def __enter__(self) -> TrainingBar:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def update(self, epoch: int, mean_return: float, env_steps_rate: float, updates_rate: float) -> None:
        """Shows a block's mean return and its environment steps and updates per second."""
        text = f"return {mean_return:.1f} · {env_steps_rate:,.0f} steps/s · {updates_rate:,.0f} updates/s"
        self._bar.update(self._task, completed=epoch, description=text)
        if self._plain:
            say(f"epoch {epoch}/{self._epochs} · {text}")
