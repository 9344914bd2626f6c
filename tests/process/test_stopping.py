"""One process per directory, and the signals that ask it to stop."""

from __future__ import annotations

import errno
import fcntl
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from ear_jax.errors import RunError
from ear_jax.process.stopping import StopRequest
from ear_jax.runs.lock import lock_directory

HERE = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}


@pytest.fixture(autouse=True)
def _heard() -> Iterator[None]:
    """Lets processes that tests start hear Ctrl-C, which a shell's background job would have them ignore."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


BUSY = """
import hashlib, signal
from ear_jax.process.stopping import StopRequest
signal.signal(signal.SIGHUP, signal.SIG_DFL)  # ignored where the tests were started by nohup
with StopRequest(lambda line: print(line, flush=True)):
    print("ready", flush=True)
    hashlib.pbkdf2_hmac("sha256", b"", b"", 2**31 - 1)  # minutes in C, where no Python handler runs
"""

LEAVES = """
import hashlib
from ear_jax.process.stopping import leave_on_interrupt
with leave_on_interrupt():
    print("ready", flush=True)
    hashlib.pbkdf2_hmac("sha256", b"", b"", 2**31 - 1)
"""

HOLDER = """
import sys
from pathlib import Path
from ear_jax.runs.lock import lock_directory
with lock_directory(Path(sys.argv[1]), print):
    print("held", flush=True)
    sys.stdin.read()
"""


CODES = {signal.SIGINT: 130, signal.SIGTERM: 143, signal.SIGHUP: 129}


@pytest.mark.parametrize(("number", "code"), CODES.items())
def test_the_first_is_answered_and_the_second_obeyed_at_once_in_the_middle_of_compiled_code(number, code):
    with subprocess.Popen([sys.executable, "-c", BUSY], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "ready\n"
        process.send_signal(number)
        assert process.stdout.readline() == "stopping after this block; a second signal stops immediately\n"
        assert process.poll() is None
        process.send_signal(number)
        assert process.wait(timeout=30) == code


def test_ctrl_c_ends_a_command_in_the_middle_of_compiled_code():
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen([sys.executable, "-c", LEAVES], **pipes) as process:
        assert process.stdout.readline() == "ready\n"
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=30) == 130
        assert process.stderr.read() == "ear: interrupted\n"


def test_handlers_are_put_back():
    before = [signal.getsignal(number) for number in CODES]
    said = []
    with StopRequest(said.append) as request:
        assert request.signal is None
        os.kill(os.getpid(), signal.SIGTERM)
        while request.signal is None:
            pass
    assert (request.signal, len(said)) == (signal.SIGTERM, 1)
    assert [signal.getsignal(number) for number in CODES] == before


def test_nohup_is_respected():
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with StopRequest(pytest.fail) as request:
            os.kill(os.getpid(), signal.SIGHUP)
            assert signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
        assert request.signal is None
    finally:
        signal.signal(signal.SIGHUP, before)


def test_in_a_thread_signals_are_left_alone():
    def enter() -> None:
        with StopRequest(pytest.fail) as request:
            seen.append((request.signal, signal.getsignal(signal.SIGINT)))

    seen: list[tuple] = []
    thread = threading.Thread(target=enter)
    thread.start()
    thread.join()
    assert seen == [(None, signal.getsignal(signal.SIGINT))]


SWALLOWS = """
import os, signal, time
from ear_jax.cli import main
def swallow(*_):
    try:
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(20)  # the process ends meanwhile
    except BaseException:
        pass
    print("it went on")
main.importlib.import_module = swallow
main.main(["doctor"])
"""


def test_ctrl_c_ends_a_command_even_where_an_import_swallows_its_exception():
    done = subprocess.run([sys.executable, "-c", SWALLOWS], env=HERE, capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "ear: interrupted\n")


@pytest.mark.slow
@pytest.mark.parametrize("tenths", range(4, 30, 2))
def test_ctrl_c_while_jax_is_imported_ends_a_command(tenths, tmp_path):
    words = [sys.executable, "-m", "ear_jax.cli.main", "train", "halfcheetah-vel", "--dry-run", "--out", str(tmp_path)]
    pipe = subprocess.PIPE
    with subprocess.Popen(words, env=HERE, stdout=pipe, stderr=pipe, text=True) as process:
        time.sleep(tenths / 10)
        process.send_signal(signal.SIGINT)
        said = process.communicate(timeout=30)
    assert (process.returncode, said[0], said[1].splitlines()[-1]) == (130, "", "ear: interrupted")


SPEAKER = """
import sys
from ear_jax.process.terminal import TrainingBar, phase, say
print("ready", flush=True)
sys.stdin.readline()
with phase("compiling"), TrainingBar(0, 4) as bar:
    for epoch in range(4):
        say("warning: the disk is full")
        bar.update(epoch, 1.0, 2.0, 3.0)
print("saved", flush=True)
"""


@pytest.mark.filterwarnings("ignore:os.fork")  # JAX warns of it, but the child replaces itself at once
@pytest.mark.parametrize("stderr", ["a pipe without a reader", "a full disk", "closed"])
def test_that_nobody_reads_what_a_run_says_does_not_end_it(stderr):
    reader, writer = os.pipe()
    full = os.open("/dev/full", os.O_WRONLY)
    closing = (lambda: os.close(2)) if stderr == "closed" else None
    target = {"a pipe without a reader": writer, "a full disk": full, "closed": None}[stderr]
    code = "from ear_jax.process.streams import open_streams as go; go()" + SPEAKER
    command, pipe = [sys.executable, "-c", code], subprocess.PIPE
    with subprocess.Popen(
        command, env=HERE, stdin=pipe, stdout=pipe, stderr=target, text=True, preexec_fn=closing
    ) as process:
        assert process.stdout.readline() == "ready\n"
        for file in (reader, writer, full):
            os.close(file)
        output, _ = process.communicate("go\n", timeout=60)
    assert (process.returncode, output) == (0, "saved\n")


@pytest.mark.filterwarnings("ignore:os.fork")  # JAX warns of it, but the child replaces itself at once
def test_a_closed_stream_leaves_its_number_to_no_file(tmp_path):
    code = (
        "from ear_jax.process.streams import open_streams as go; go(); import os, sys;"
        "file = open(sys.argv[1], 'w'); assert file.fileno() > 2; os.write(2, b'noise')"
    )
    command = [sys.executable, "-c", code, str(tmp_path / "file")]
    subprocess.run(command, env=HERE, check=True, preexec_fn=lambda: os.closerange(0, 3))
    assert (tmp_path / "file").read_bytes() == b""


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


def test_a_file_system_without_locks_is_told_of(tmp_path, monkeypatch):
    def refuse(*_: object) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(fcntl, "flock", refuse)
    with pytest.raises(RunError, match=r"cannot lock .*lock: No locks available"), lock_directory(tmp_path, print):
        pass


def test_a_link_in_the_place_of_the_lock_is_not_followed(tmp_path):
    victim = tmp_path / "victim"
    victim.write_text("precious")
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "lock").symlink_to(victim)
    with pytest.raises(RunError, match="cannot make"), lock_directory(tmp_path / "run", print):
        pass
    assert victim.read_text() == "precious"
