"""Signals that stop: after the first a run saves at the end of its block and stops; a second ends it immediately.

They are Ctrl-C (SIGINT), SIGTERM, and SIGHUP, which a closed terminal sends. Before training, Ctrl-C ends a command.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import threading
from collections.abc import Callable, Iterator
from types import FrameType, TracebackType
from typing import Any

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
SHOW_CURSOR = b"\x1b[?25h"  # the progress bar hides it
PARENT = "EAR_JAX_PARENT"  # the variable that names the process with which another stops
PR_SET_PDEATHSIG = 1  # of Linux's prctl


class Stopped(Exception):
    """A signal stopped the run after it saved; `exit_code` is the shell's for that signal (130, 143 or 129)."""

    def __init__(self, number: int):
        self.exit_code = 128 + number
        super().__init__(signal.Signals(number).name)


class StopRequest:
    """A context that records the first stop signal instead of ending the process.

    Python runs signal handlers only between bytecodes of the main thread, which spends a whole block inside a compiled
    program. A separate thread therefore reads signals from the pipe that the interpreter writes them to. SIGHUP stays
    ignored where it was, as by `nohup`.

    Entered in another thread it records none, as signals are the main thread's; they do what the program decides.
    """

    def __init__(self, announce: Callable[[str], None], unit: str = "block"):
        """Creates one that announces that the program stops after the `unit` in hand."""
        self.signal: int | None = None
        self._announce = announce
        self._unit = unit
        self._listens = False

    def __enter__(self) -> StopRequest:
        self._old_handlers: dict[int, Any] = {}
        self._listens = threading.current_thread() is threading.main_thread()
        if not self._listens:
            return self
        self._read_end, self._write_end = os.pipe()
        os.set_blocking(self._write_end, False)
        for number in SIGNALS:
            if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:
                self._old_handlers[number] = signal.signal(number, lambda *_: None)
        self._old_wakeup_fd = signal.set_wakeup_fd(self._write_end)
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if not self._listens:
            return
        signal.set_wakeup_fd(self._old_wakeup_fd)
        for number, handler in self._old_handlers.items():
            signal.signal(number, handler)
        os.close(self._write_end)  # ends the thread
        self._thread.join()
        os.close(self._read_end)

    def _listen(self) -> None:
        while byte := os.read(self._read_end, 1):
            if byte[0] in SIGNALS:
                self._handle(byte[0])

    def _handle(self, number: int) -> None:
        if self.signal is not None:
            _leave(number)  # safe during a save, which is atomic
        self.signal = number
        self._announce(f"stopping after this {self._unit}; a second signal stops immediately")


@contextlib.contextmanager
def leave_on_interrupt() -> Iterator[None]:
    """A context in which Ctrl-C ends the process at once, with exit code 130.

    Python's own way, an exception, may come up inside a library that swallows it, as while JAX is imported. Nothing is
    half-written by leaving, as outputs replace files whole.
    """
    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:  # the program has its own way, or ignores it
        yield
        return
    with contextlib.ExitStack() as after:
        if threading.current_thread() is threading.main_thread():
            after.callback(signal.signal, signal.SIGINT, signal.signal(signal.SIGINT, _say_and_leave))
        yield


def child_environment() -> dict[str, str]:
    """Returns the environment of a command that should stop when this process ends, however it ends."""
    return {**os.environ, PARENT: str(os.getpid())}


def stop_with_parent() -> None:
    """Makes the kernel send SIGTERM to this process when its parent ends, if that started it to be so."""
    parent = os.environ.pop(PARENT, "")  # not for processes that this one starts
    if not parent:
        return
    with contextlib.suppress(AttributeError):  # of another system than Linux
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
    if str(os.getppid()) != parent:  # which ended before
        _leave(signal.SIGTERM)


def _say_and_leave(number: int, _: FrameType | None) -> None:
    with contextlib.suppress(OSError):
        os.write(2, b"ear: interrupted\n")
    _leave(number)


def _leave(number: int) -> None:
    with contextlib.suppress(OSError):  # of a terminal that is gone
        if os.isatty(2):
            os.write(2, SHOW_CURSOR)
    os._exit(128 + number)
