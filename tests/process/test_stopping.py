"""One process per directory, and the two signals that ask it to stop."""

from __future__ import annotations

import os
import signal
import subprocess
import sys

import pytest

from ear_jax.errors import RunError
from ear_jax.process.stopping import StopRequest
from ear_jax.runs.lock import lock_directory

BUSY = """
import hashlib, sys
from ear_jax.process.stopping import StopRequest
with StopRequest(lambda line: print(line, flush=True)):
    print("ready", flush=True)
    hashlib.pbkdf2_hmac("sha256", b"", b"", 2**31 - 1)  # minutes in C, where no Python handler runs
"""

HOLDER = """
import sys
from pathlib import Path
from ear_jax.runs.lock import lock_directory
with lock_directory(Path(sys.argv[1]), print):
    print("held", flush=True)
    sys.stdin.read()
"""


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_the_first_is_answered_and_the_second_obeyed_at_once_in_the_middle_of_compiled_code(number, code):
    with subprocess.Popen([sys.executable, "-c", BUSY], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "ready\n"
        process.send_signal(number)
        assert process.stdout.readline() == "stopping after this block; a second signal stops immediately\n"
        assert process.poll() is None
        process.send_signal(number)
        assert process.wait(timeout=30) == code


def test_handlers_are_put_back():
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    said = []
    with StopRequest(said.append) as request:
        assert request.signal is None
        os.kill(os.getpid(), signal.SIGTERM)
        while request.signal is None:
            pass
    assert (request.signal, len(said)) == (signal.SIGTERM, 1)
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before


def test_a_second_process_is_refused_with_the_firsts_name(tmp_path):
    command, pipe = [sys.executable, "-c", HOLDER, str(tmp_path)], subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) as process:
        assert process.stdout.readline() == "held\n"
        expected = rf"{tmp_path} is in use by process {process.pid} on \S+; wait for it, or name another --out"
        with pytest.raises(RunError, match=expected), lock_directory(tmp_path, print):
            pass
        process.kill()
        process.wait()
    said: list[str] = []
    with lock_directory(tmp_path, said.append):
        pass
    assert f"process {process.pid} on " in said[0]
    assert said[0].endswith("was killed; ignoring its lock")
    with lock_directory(tmp_path, said.append):
        pass
    assert len(said) == 1, "and once is enough"


def test_a_link_in_the_place_of_the_lock_is_not_followed(tmp_path):
    victim = tmp_path / "victim"
    victim.write_text("precious")
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "lock").symlink_to(victim)
    with pytest.raises(RunError, match="cannot make"), lock_directory(tmp_path / "run", print):
        pass
    assert victim.read_text() == "precious"
