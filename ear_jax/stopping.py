"""Ctrl-C and SIGTERM: asked once, a run saves at the next block and stops; asked twice, it leaves at once."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from types import FrameType, TracebackType


class Stopped(Exception):
    """The run was asked to stop and has saved; `exit_code` is the shell's for the signal (130 or 143)."""

    def __init__(self, number: int):
        self.exit_code = 128 + number
        super().__init__(signal.Signals(number).name)


class StopRequest:
    """While entered, remembers the first signal that asks to stop instead of dying of it."""

    def __init__(self, announce: Callable[[str], None]):
        self.signal: int | None = None
        self._announce = announce
        self._before: dict[int, object] = {}

    def __enter__(self) -> StopRequest:
        for number in (signal.SIGINT, signal.SIGTERM):
            self._before[number] = signal.signal(number, self._ask)
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, trace: TracebackType | None) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)  # type: ignore[arg-type]

    def _ask(self, number: int, frame: FrameType | None) -> None:
        if self.signal is not None:
            os._exit(128 + number)  # in the middle of a save too: a step is whole or not there
        self.signal = number
        self._announce("stopping after this block; once more to leave at once")
