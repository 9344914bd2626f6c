"""Ctrl-C and SIGTERM: asked once, a run saves at the next block and stops; asked twice, it leaves at once."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable
from types import TracebackType
from typing import Any

SIGNALS = (signal.SIGINT, signal.SIGTERM)
SHOW_CURSOR = b"\x1b[?25h"  # which a progress bar had hidden


class Stopped(Exception):
    """The run was asked to stop and has saved; `exit_code` is the shell's for the signal (130 or 143)."""

    def __init__(self, number: int):
        self.exit_code = 128 + number
        super().__init__(signal.Signals(number).name)


class StopRequest:
    """While entered, remembers the first signal that asks to stop instead of dying of it.

    Python runs a signal's handler only between two steps of the main thread, which spends a whole block inside a
    compiled program. So a thread of its own hears of signals, through the pipe the interpreter writes them to.
    """

    def __init__(self, announce: Callable[[str], None]):
        self.signal: int | None = None
        self._announce = announce

    def __enter__(self) -> StopRequest:
        self._pipe, writing = os.pipe()
        os.set_blocking(writing, False)
        self._before: dict[int, Any] = {number: signal.signal(number, lambda *_: None) for number in SIGNALS}
        self._writing, self._written_before = writing, signal.set_wakeup_fd(writing)
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, trace: TracebackType | None) -> None:
        signal.set_wakeup_fd(self._written_before)
        for number, handler in self._before.items():
            signal.signal(number, handler)
        os.close(self._writing)  # ends the thread
        self._thread.join()
        os.close(self._pipe)

    def _listen(self) -> None:
        while byte := os.read(self._pipe, 1):
            if byte[0] in SIGNALS:
                self._ask(byte[0])

    def _ask(self, number: int) -> None:
        if self.signal is not None:
            if os.isatty(2):
                os.write(2, SHOW_CURSOR)
            os._exit(128 + number)  # in the middle of a save too: a step is whole or not there
        self.signal = number
        self._announce("stopping after this block; once more to leave at once")
