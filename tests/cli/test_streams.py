"""Streams as shells hand them over: encodings without Greek, closed or full ones, and results alone on stdout."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from threading import Event

import pytest
from rich.console import Console

from ear_jax.cli.main import main
from ear_jax.process import terminal
from ear_jax.process.streams import results_only

EAR = f"{sys.executable} -m ear_jax.cli.main"


def shell(line: str, **variables: str) -> subprocess.CompletedProcess[bytes]:
    """Runs a line of bash in which `ear` is this package's command."""
    script = f'ear() {{ {EAR} "$@"; }}; {line}'
    return subprocess.run(["bash", "-c", script], env={**os.environ, **variables}, capture_output=True, timeout=60)


@pytest.mark.parametrize("encoding", ["cp1252", "ascii", "latin-1", "koi8-r"])
def test_letters_that_an_encoding_lacks_are_spelt_out(encoding):
    done = shell("ear interpolate --help; ear frobnicate β", PYTHONIOENCODING=encoding)
    assert (done.returncode, b"Traceback" in done.stderr) == (2, False)
    printed = done.stdout.decode(encoding)
    assert "f(beta Z_1 + (1 - beta) Z_2)" in printed
    assert done.stderr.startswith(b"ear: unknown command 'frobnicate'")


@pytest.mark.parametrize(
    ("line", "code", "complaint"),
    [
        ("ear pretrained --json >&-", 1, b"ear: cannot write to standard output: Bad file descriptor\n"),
        ("ear --version >&-", 1, b"ear: cannot write to standard output: Bad file descriptor\n"),
        ("ear pretrained --json >/dev/full", 1, b"ear: cannot write to standard output: No space left on device\n"),
        ("ear --help >/dev/full", 1, b"ear: cannot write to standard output: No space left on device\n"),
        ("ear evaluate nowhere 2>&-", 2, b""),
        ("ear evaluate nowhere >&- 2>&- <&-", 2, b""),
        ("ear pretrained --json <&- | true; exit ${PIPESTATUS[0]}", 1, b""),
    ],
)
def test_a_closed_or_full_stream_is_one_line(line, code, complaint):
    done = shell(line)
    assert (done.returncode, done.stdout, done.stderr) == (code, b"", complaint)


def test_the_locale_c_has_no_traceback():
    done = shell("ear pretrained", LC_ALL="C", PYTHONUTF8="0", PYTHONCOERCECLOCALE="0")
    assert (done.returncode, b"Traceback" in done.stderr) == (0, False)
    assert b"halfcheetah-vel" in done.stdout


def test_nothing_of_an_error_reaches_a_stdout_that_others_read():
    done = shell("ear pretrained --json 2>&-")
    assert json.loads(done.stdout)["pretrained"]
    assert shell("ear evaluate nowhere --json 2>&-").stdout == b""


def test_what_one_thread_prints_aside_leaves_the_others_stdout_alone(capsys):
    """A second thread begins before the first one ends, and ends after it."""
    before, entered, leave = sys.stdout, (Event(), Event()), (Event(), Event())

    def work(number: int) -> None:
        with results_only():
            print("aside", number)
            entered[number].set()
            leave[number].wait(30)

    with ThreadPoolExecutor(2) as pool:
        working = []
        for number in (0, 1):
            working.append(pool.submit(work, number))
            entered[number].wait(30)
            print("result", number)
        for number in (0, 1):
            leave[number].set()
            working[number].result()
            print("end", number)
    assert sys.stdout is before
    streams = capsys.readouterr()
    assert streams.out.splitlines() == ["result 0", "result 1", "end 0", "end 1"]
    assert streams.err.splitlines() == ["aside 0", "aside 1"]


def test_two_live_lines_at_a_time_disturb_neither_each_other_nor_stdout(monkeypatch, capsys):
    """A program that trains in two threads on one terminal."""
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(terminal, "console", Console(stderr=True, force_terminal=True, width=60))
    before = sys.stdout, sys.stderr

    def train(number: int) -> None:
        with terminal.phase(f"compiling {number}"):
            time.sleep(0.15)
        with terminal.TrainingBar(0, 10) as bar:
            for epoch in range(3):
                time.sleep(0.1 + 0.05 * number)
                bar.update(epoch, 1.0, 2.0, 3.0)

    with ThreadPoolExecutor(2) as pool:
        for done in [pool.submit(train, number) for number in (0, 1)]:
            done.result()
    assert (sys.stdout, sys.stderr) == before
    print("result")
    assert capsys.readouterr().out == "result\n"


def test_a_command_runs_in_any_thread(capsys):
    with ThreadPoolExecutor(1) as pool:
        assert pool.submit(main, ["pretrained", "--json"]).result() == 0
    assert json.loads(capsys.readouterr().out)["pretrained"]


def test_command_lines_that_are_parsed_at_once_leave_stderr_alone():
    stderr = sys.stderr
    with ThreadPoolExecutor(4) as threads:
        codes = list(threads.map(main, [["evaluate", "nowhere", "--episodes", "many"]] * 8))
    assert codes == [2] * 8
    assert sys.stderr is stderr
