"""Streams as shells hand them over: encodings without Greek, closed or full ones, and results alone on stdout."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest

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


def test_nothing_of_an_error_reaches_a_stdout_that_others_read():
    done = shell("ear pretrained --json 2>&-")
    assert json.loads(done.stdout)["pretrained"]
    assert shell("ear evaluate nowhere --json 2>&-").stdout == b""
