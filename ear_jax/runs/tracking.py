"""Copies of `metrics.jsonl`, the source of truth, for TensorBoard and Weights & Biases. Imports no JAX."""

from __future__ import annotations

import contextlib
import time
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Protocol

from ear_jax.config import Config, flat
from ear_jax.errors import RunError
from ear_jax.runs import records

Rows = list[dict[str, Any]]

TENSORBOARD = "tensorboard"  # folder of a run
WANDB = "wandb.json"  # file of a run: the name of its copies on Weights & Biases, and the last epoch copied
EVENTS = "events.out.tfevents.*"
STEP = "env_steps"  # the horizontal axis in both


class Tracker(Protocol):
    """Receives rows of metrics in order."""

    def write(self, rows: Rows) -> None:
        """Writes rows, each of one seed."""
        ...

    def close(self) -> None: ...


@contextlib.contextmanager
def tracking(run: Path, config: Config, warn: Callable[[str], None]) -> Iterator[Callable[[Rows], None]]:
    """Copies the rows of `metrics.jsonl`, and those that are then passed to the function it yields.

    Once opened, a tracker that fails is dropped with a warning: training goes on, and `ear log` copies the rest.

    Args:
      run: the run's directory.
      config: the run's settings; `log.tensorboard` and `log.wandb` choose the trackers.
      warn: receives warnings.

    Raises:
      RunError: a tracker is not installed, or cannot be opened.
    """
    with contextlib.ExitStack() as stack:
        trackers: list[Tracker] = []
        for wanted, open_tracker in ((config.log.tensorboard, TensorBoard), (config.log.wandb, Wandb)):
            if wanted:
                trackers.append(open_tracker(run, flat(config)))
                stack.callback(_closed, trackers[-1])

        def write(rows: Rows) -> None:
            for tracker in tuple(trackers):
                try:
                    tracker.write(rows)
                except Exception as error:  # of any library: none of its errors may end a run
                    trackers.remove(tracker)
                    warn(f"warning: {type(tracker).__name__} gets no more metrics: {error}; `ear log` copies the rest")

        if trackers:
            write(records.read_rows(run / "metrics.jsonl"))
        yield write


def scalars(row: dict[str, Any]) -> dict[str, float]:
    """Returns the numbers of a row by the name of their curve: the returns of single tasks under `returns/`."""
    numbers = {name: value for name, value in row.items() if isinstance(value, int | float)}
    numbers["minutes"] = numbers.pop("seconds") / 60
    own = {name: value for name, value in numbers.items() if name not in ("seed", STEP)}
    return {**own, **{f"returns/{task}": value for task, value in row["returns"].items()}}


class TensorBoard:
    """Event files, in one folder for each seed; a run that continues writes them anew."""

    def __init__(self, run: Path, config: dict[str, Any]):
        self._folder = run / TENSORBOARD
        self._config = config
        self._files: dict[int, Any] = {}
        metrics = run / "metrics.jsonl"
        rows = records.read_rows(metrics)
        # Rows know the seconds since the run began, and the file the time of its last row.
        self._began = metrics.stat().st_mtime - rows[-1]["seconds"] if rows else None
        for old in self._folder.glob(f"seed*/{EVENTS}"):
            old.unlink()

    def write(self, rows: Rows) -> None:
        from tensorboardX import summary
        from tensorboardX.proto.event_pb2 import Event

        for row in rows:
            file = self._files.get(row["seed"]) or self._open(row["seed"], row)
            for name, value in scalars(row).items():
                file.write_event(Event(wall_time=self._time(row), step=row[STEP], summary=summary.scalar(name, value)))
        for file in self._files.values():
            file.flush()

    def close(self) -> None:
        for file in self._files.values():
            file.close()

    def _open(self, seed: int, row: dict[str, Any]) -> Any:
        from tensorboardX import summary
        from tensorboardX.event_file_writer import EventsWriter
        from tensorboardX.proto.event_pb2 import Event

        folder = records.folder(self._folder / f"seed{seed}")
        file = self._files[seed] = EventsWriter(str(folder / "events"))
        table = "\n".join(
            ["| setting | value |", "|---|---|", *(f"| {name} | {self._config[name]} |" for name in self._config)]
        )
        file.write_event(Event(wall_time=self._time(row), summary=summary.text("settings", table)))
        return file

    def _time(self, row: dict[str, Any]) -> float:
        if self._began is None:
            self._began = time.time() - row["seconds"]
        return self._began + row["seconds"]


class Wandb:
    """Runs on Weights & Biases, a group of one for each seed; a run that continues goes on in its own."""

    def __init__(self, run: Path, config: dict[str, Any]):
        try:
            import wandb
        except ImportError:
            raise RunError("Weights & Biases is not installed: pip install 'ear-jax[wandb]'") from None
        self._wandb, self._run, self._config = wandb, run, config
        self._runs: dict[int, Any] = {}
        self._name, self._epoch = self._place()
        for seed in range(config["seed"], config["seed"] + config["seeds"]):
            self._runs[seed] = self._open(seed)

    def write(self, rows: Rows) -> None:
        """Writes the rows that are not there yet: unlike event files, nothing can be taken back there."""
        fresh = [row for row in rows if row["epoch"] > self._epoch]
        for row in fresh:
            self._runs[row["seed"]].log(scalars(row), step=row[STEP])
        if fresh:
            self._epoch = max(row["epoch"] for row in fresh)
            records.write_json(self._run / WANDB, {"id": self._name, "epoch": self._epoch})

    def close(self) -> None:
        for run in self._runs.values():
            run.finish()

    def _place(self) -> tuple[str, int]:
        """Returns the name under which a run continues there, new for one trained anew, and its last epoch there."""
        path = self._run / WANDB
        if not path.exists():
            records.write_json(path, {"id": uuid.uuid4().hex[:12], "epoch": 0})
        known = records.read_json(path)
        return str(known["id"]), int(known["epoch"])

    def _open(self, seed: int) -> Any:
        try:
            return self._wandb.init(
                project="ear_jax",
                group=f"{self._run.name}-{self._name}",
                name=f"{self._run.name} seed {seed}",
                id=f"{self._name}-{seed}",
                resume="allow",
                reinit="create_new",
                config={**self._config, "seed": seed},
                dir=self._run,
                settings=self._wandb.Settings(console="off", silent=True),
            )
        except Exception as error:  # wandb raises errors of its own and of its HTTP library
            reason = " ".join(str(error).split())
            raise RunError(
                f"Weights & Biases cannot be used: {reason} (WANDB_MODE=offline keeps its files in {self._run})"
            ) from None


def _closed(tracker: Tracker) -> None:
    with contextlib.suppress(Exception):
        tracker.close()
