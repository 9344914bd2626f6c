"""Signals that stop: after the first a run saves at the end of its block and stops; a second ends it immediately.

They are Ctrl-C (SIGINT), SIGTERM, and SIGHUP, which a closed terminal sends. Before training, Ctrl-C ends a command.
"""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from types import TracebackType

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
SHOW_CURSOR = b"\x1b[?25h"  # the progress bar hides it
PARENT = "EAR_JAX_PARENT"  # the variable that names the process with which another stops
PR_SET_PDEATHSIG = 1  # of Linux's prctl


class Stopped(Exception):
    """A signal stopped the run after it saved; `exit_code` is the shell's for that signal (130, 143 or 129)."""

    def __init__(self, number: int):
        self.exit_code = 128 + number
        super().__init__(signal.Signals(number).name)


class Listener:
    """A context in which a thread of its own handles signals.

    Python runs signal handlers only between bytecodes of the main thread, which spends whole blocks and roll-outs
    inside a compiled program. The thread therefore reads signals from the pipe that the interpreter writes them to.
    """

    def __init__(self, numbers: Sequence[int], handle: Callable[[int], None]):
        """Creates one for some signals; `handle` gets the number of each that comes."""
        self._numbers = numbers
        self._handle = handle

    def __enter__(self) -> Listener:
        self._read_end, self._write_end = _pipe()
        os.set_blocking(self._write_end, False)
        self._old_handlers = {number: signal.signal(number, lambda *_: None) for number in self._numbers}
        self._old_wakeup_fd = signal.set_wakeup_fd(self._write_end)
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, trace: TracebackType | None) -> None:
        signal.set_wakeup_fd(self._old_wakeup_fd)
        for number, handler in self._old_handlers.items():
            signal.signal(number, handler)
        os.close(self._write_end)  # ends the thread
        self._thread.join()
        os.close(self._read_end)

    def _listen(self) -> None:
        while byte := os.read(self._read_end, 1):
            if byte[0] in self._numbers:
                self._handle(byte[0])


def _pipe() -> tuple[int, int]:
    """Returns the ends of a pipe, which take the place of no standard stream that is closed."""
    ends = os.pipe()
    read_end, write_end = (fcntl.fcntl(end, fcntl.F_DUPFD_CLOEXEC, 3) for end in ends)
    for end in ends:
        os.close(end)
    return read_end, write_end


class StopRequest:
    """A context that records the first stop signal instead of ending the process.

    SIGHUP stays ignored where it was, as by `nohup`. Entered in another thread it records none, as signals are the main
    thread's; they do what the program decides.
    """

    def __init__(self, announce: Callable[[str], None], unit: str = "block"):
        """Creates one that announces that the program stops after the `unit` in hand."""
        self.signal: int | None = None
        self._announce = announce
        self._unit = unit
        self._entered = contextlib.ExitStack()

    def __enter__(self) -> StopRequest:
        if threading.current_thread() is threading.main_thread():
            self._entered.enter_context(Listener(stop_signals(), self._handle))
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._entered.close()

    def _handle(self, number: int) -> None:
        if self.signal is not None:
            _leave(number)  # safe during a save, which is atomic
        self.signal = number
        self._announce(f"stopping after this {self._unit}; a second signal stops immediately")


def stop_signals() -> list[signal.Signals]:
    """Returns the signals that stop this process: `SIGNALS` without a SIGHUP that was ignored, as by `nohup`."""
    ignored = signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
    return [number for number in SIGNALS if number != signal.SIGHUP or not ignored]


@contextlib.contextmanager
def leave_on_interrupt() -> Iterator[None]:
    """A context in which Ctrl-C ends the process at once, with exit code 130, also inside a compiled program.

    Python's own way, an exception, may come up inside a library that swallows it, as while JAX is imported. Nothing is
    half-written by leaving, as outputs replace files whole.
    """
    # Where the program has its own way, or ignores Ctrl-C, or this is another thread, nothing changes.
    own = signal.getsignal(signal.SIGINT) is not signal.default_int_handler
    if own or threading.current_thread() is not threading.main_thread():
        yield
        return
    with Listener((signal.SIGINT,), _say_and_leave):
        yield


def child_environment() -> dict[str, str]:
    """Returns the environment of a command that should stop when this process ends, however it ends."""
    return {**os.environ, PARENT: str(os.getpid())}


def stop_with_parent() -> None:
    """Makes the kernel send SIGTERM to this process when its parent ends, if that used `child_environment`."""
    parent = os.environ.pop(PARENT, "")  # not for processes that this one starts
    if not parent:
        return
    with contextlib.suppress(AttributeError):  # of another system than Linux
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
    if str(os.getppid()) != parent:  # which ended before
        _leave(signal.SIGTERM)


def _say_and_leave(number: int) -> None:
    with contextlib.suppress(OSError):
        os.write(2, b"ear: interrupted\n")
    _leave(number)


def _leave(number: int) -> None:
    with contextlib.suppress(OSError):  # of a terminal that is gone
        if os.isatty(2):
            os.write(2, SHOW_CURSOR)
    os._exit(128 + number)
