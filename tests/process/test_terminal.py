"""Progress on a pseudo-terminal: live where the cursor moves, plain lines elsewhere, and nothing lost in 40 columns."""

from __future__ import annotations

import contextlib
import fcntl
import os
import pty
import re
import struct
import subprocess
import sys
import termios
import time

import pytest
from rich.console import Console

from ear_jax.cli import on_run
from ear_jax.cli.main import main
from ear_jax.errors import RunError
from ear_jax.process import terminal
from ear_jax.process.progress import env_steps

TRAINING = """
import time
from ear_jax.process.terminal import TrainingBar, phase
with phase("compiling [/x]"):
    print("a user's print")
    time.sleep(0.2)
with TrainingBar(0, 4000) as bar:
    for epoch in (10, 20):
        time.sleep(0.2)
        bar.update(epoch, -1166.23, 12345.0, 456.0)
    time.sleep(0.2)
"""


def on_terminal(code: str, columns: int, kind: str) -> str:
    """Runs Python code on a terminal of a width and a kind, and returns what it shows."""
    screen, inside = pty.openpty()
    fcntl.ioctl(inside, termios.TIOCSWINSZ, struct.pack("HHHH", 30, columns, 0, 0))
    variables = {**os.environ, "TERM": kind}
    variables.pop("COLUMNS", None)
    process = subprocess.Popen([sys.executable, "-c", code], env=variables, stdin=inside, stdout=inside, stderr=inside)
    os.close(inside)
    shown = b""
    with contextlib.suppress(OSError):  # which reading raises once the process has ended
        while part := os.read(screen, 65536):
            shown += part
    os.close(screen)
    assert process.wait() == 0, shown
    return shown.decode()


@pytest.mark.parametrize("columns", [40, 100])
def test_a_terminal_shows_epoch_return_and_time_left_in_any_width(columns):
    shown = on_terminal(TRAINING, columns, "xterm")
    assert "compiling [/x]" in shown
    lines = [re.sub(r"\x1b\[[\d;?]*[A-Za-z]", "", line) for line in re.split(r"\r\n|\r|\x1b\[2K", shown)]
    assert max(map(len, lines)) <= columns
    (last,) = {line for line in lines if re.search(r"20/4000 .* -1166\.2 .*0:\d\d:\d\d left", line)} and {lines[-2]}
    assert ("steps/s" in last) == (columns == 100)


@pytest.mark.parametrize("kind", ["dumb", "unknown"])
def test_a_terminal_that_cannot_move_its_cursor_gets_lines(kind):
    shown = on_terminal(TRAINING, 80, kind)
    assert "\x1b" not in shown
    lines = shown.splitlines()
    assert lines[:2] == ["compiling [/x] …", "a user's print"]
    assert [line.split(" · ")[:2] for line in lines[3:]] == [[f"epoch {n}/4000", "return -1166.2"] for n in (10, 20)]
    assert all(re.search(r"\d:\d\d:\d\d left", line) for line in lines[4:])


@pytest.mark.parametrize(("width", "time_left"), [(20, True), (40, True), (80, True)])
def test_the_shortest_form_is_what_matters(width, time_left, monkeypatch):
    monkeypatch.setattr(terminal, "console", Console(width=width, stderr=True))
    bar = terminal.TrainingBar(0, 200)
    bar.update(10, -12.3, 100.0, 200.0)
    time.sleep(0.01)
    bar.update(20, -12.3, 100.0, 200.0)
    line = terminal.BlockColumn().render(bar._bar.tasks[0]).plain
    assert ("20/200" in line, "-12.3" in line, "left" in line) == (True, True, time_left)


def test_a_long_roll_out_shows_the_steps_it_took(monkeypatch, capsys):
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(terminal, "console", Console(stderr=True, force_terminal=True, width=60))
    env_steps.add(7)
    with terminal.phase("rolling out"):
        env_steps.add(1200)
        time.sleep(0.15)
    shown = capsys.readouterr().err
    assert "1,200 env steps" in shown
    assert "rolling out: " in shown.splitlines()[-1]


def test_a_terminal_shows_the_command_before_it_is_imported():
    code = """
import sys
from ear_jax.cli.main import main
class Finder:
    def find_spec(name, *_):
        if name == "tyro":
            print("first")
sys.meta_path.insert(0, Finder)
sys.exit(main(["pretrained", "--json"]))
"""
    shown = on_terminal(code, 80, "xterm")
    assert 0 <= shown.find("ear pretrained …") < shown.find("first") < shown.find("\x1b[2K") < shown.find("{")
    assert "\x1b" not in on_terminal(code, 80, "dumb")


def test_a_terminal_shows_a_sign_of_life_before_jax_starts(monkeypatch, capsys):
    def refuse() -> None:
        time.sleep(0.15)
        raise RunError("no JAX here")

    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(terminal, "console", Console(stderr=True, force_terminal=True, width=60))
    monkeypatch.setattr(on_run, "start_jax", refuse)
    assert main(["evaluate", "pretrained:hopper-vel"]) == 1
    shown = capsys.readouterr().err
    assert 0 <= shown.find("loading pretrained:hopper-vel") < shown.find("ear: no JAX here")
