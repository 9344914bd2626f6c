"""The standard streams of a process, as the shell hands them over: closed, or with an encoding that lacks letters."""

from __future__ import annotations

import codecs
import contextlib
import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

OF_PYTHON = ("strict", "backslashreplace", "surrogateescape")  # its own ways with letters that an encoding lacks
PLAIN = {"β": "beta", "σ": "sigma", "φ": "phi", "ψ": "psi", "γ": "gamma", "…": "...", "−": "-", "–": "-", "—": "-"}
PLAIN |= {
    "·": "|",
    "’": "'",
    "±": "+-",
    "²": "^2",
    "⁻": "^-",
    "½": "1/2",
    "₁": "_1",
    "₂": "_2",
    "Σ": "sum",
}
PLAIN |= {"─": "-", "│": "|", "╭": "+", "╮": "+", "╰": "+", "╯": "+", "∝": "~", "°": " deg"}


def _spell_out(error: UnicodeError) -> tuple[str, int]:
    """Replaces letters that an encoding lacks by others that mean the same, or by question marks."""
    assert isinstance(error, UnicodeEncodeError)
    lacking = error.object[error.start : error.end]
    return "".join(PLAIN.get(letter, "?") for letter in lacking), error.end


codecs.register_error("ear_jax", _spell_out)


def open_streams() -> None:
    """Makes the standard streams usable.

    A closed one becomes the null device, so that no file that is opened later gets its number. On a closed stdout every
    write fails, because results would be lost. Letters that the encoding lacks are spelt out.
    """
    for number, mode in ((0, os.O_RDONLY), (1, os.O_RDONLY), (2, os.O_WRONLY)):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, mode)  # takes the lowest free number, which is this one
    if sys.stdout is None:
        sys.stdout = open(1, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
    if sys.stderr is None:
        sys.stderr = open(2, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if getattr(stream, "errors", None) in OF_PYTHON and hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="ear_jax")


@contextmanager
def starting(name: str) -> Iterator[None]:
    """Shows a name on a terminal meanwhile, at once: nothing is imported for it."""
    live = sys.stderr.isatty() and os.environ.get("TERM", "dumb").lower() not in ("dumb", "unknown", "")
    if not live:
        yield
        return
    print(f"{name} …", end="", flush=True, file=sys.stderr)
    try:
        yield
    finally:
        print("\r\x1b[2K", end="", flush=True, file=sys.stderr)


def flush_results() -> str | None:
    """Flushes stdout; returns why it cannot be written, "" if its reader has left, and None if all is written."""
    try:
        sys.stdout.flush()
    except BrokenPipeError:
        reason = ""
    except OSError as error:
        reason = error.strerror or str(error)
    else:
        return None
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # what is left is not tried again at exit
    return reason


@contextmanager
def libraries_muted() -> Iterator[None]:
    """Sends nowhere meanwhile what libraries write on stdout past Python, such as Gloo's news of its connections."""
    kept, nowhere = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    try:
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)
        os.close(nowhere)


class Stderr:
    """The process's stderr without its errors; after the first one its text goes nowhere."""

    def write(self, text: str) -> int:
        with self._muted_on_error():
            sys.stderr.write(text)
        return len(text)

    def flush(self) -> None:
        with self._muted_on_error():
            sys.stderr.flush()

    @contextmanager
    def _muted_on_error(self) -> Iterator[None]:
        try:
            yield
        except OSError:  # its reader has left, its disk is full, its terminal is gone
            with contextlib.suppress(OSError):
                os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stderr.fileno())

    def __getattr__(self, name: str) -> Any:
        return getattr(sys.stderr, name)


@contextmanager
def results_only() -> Iterator[None]:
    """Sends what this thread prints on stdout to stderr meanwhile; what other threads print stays where it belongs.

    Of threads that enter at the same time the last one to leave puts stdout back.
    """
    token = _aside.set(True)
    with _changing:
        _entered.append(token)
        if not isinstance(sys.stdout, _Stdout):
            sys.stdout = _Stdout(sys.stdout)  # type: ignore[assignment]
    try:
        yield
    finally:
        _aside.reset(token)
        with _changing:
            _entered.remove(token)
            if not _entered and isinstance(sys.stdout, _Stdout):
                sys.stdout = sys.stdout.stdout


class _Stdout:
    """Stands in for stdout, and is stderr for threads within `results_only`."""

    def __init__(self, stdout: Any):
        self.stdout = stdout

    def __getattr__(self, name: str) -> Any:
        return getattr(Stderr() if _aside.get() else self.stdout, name)


_aside: ContextVar[bool] = ContextVar("aside", default=False)
_changing = threading.Lock()  # of stdout
_entered: list[Any] = []  # a token for each `results_only` that is entered now
