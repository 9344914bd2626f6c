"""Outputs are written whole or not at all, under names of their own, and never through links."""

from __future__ import annotations

import fcntl
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from ear_jax.embeddings import ltes
from ear_jax.errors import RunError
from ear_jax.figures.style import save_figure
from ear_jax.figures.video import write_gif, write_mp4
from ear_jax.files.replacing import claim_file, copy_file, folder, lock_file, replace_file, write_text
from ear_jax.runs import safetensors
from tests.helpers.faults import each_kill

ROOT = Path(__file__).parents[2]


def figure(path: Path) -> None:
    save_figure(Figure(figsize=(1, 1)), path)


def film(path: Path) -> None:
    write_gif(path, [np.full((8, 8, 3), shade, np.uint8) for shade in (0, 90, 250)], 0.1)


def policy(path: Path) -> None:
    safetensors.write(path, {"codes": np.ones((2, 3), np.float32)}, {"card": "new"})


WRITERS = {"x.txt": lambda path: write_text(path, "new"), "x.png": figure, "x.gif": film, "x.safetensors": policy}


@pytest.fixture(params=WRITERS)
def written(request, tmp_path):
    """A file with a good content, and what replaces it."""
    path = tmp_path / request.param
    path.write_text("good")
    return path, WRITERS[request.param]


def test_a_file_is_replaced_and_nothing_else_is_left(written):
    path, write = written
    write(path)
    assert path.read_bytes() not in (b"", b"good")
    assert list(path.parent.iterdir()) == [path]
    assert path.stat().st_mode & 0o777 == 0o666 & ~os.umask(os.umask(0o022))


def test_a_link_is_replaced_and_not_written_through(written, tmp_path_factory):
    path, write = written
    precious = tmp_path_factory.mktemp("elsewhere") / "precious"
    precious.write_text("precious")
    path.unlink()
    path.symlink_to(precious)
    write(path)
    assert precious.read_text() == "precious"
    assert not path.is_symlink()


def test_a_full_disk_leaves_the_old_file_and_names_it(written, small_files):
    path, write = written
    with small_files(1), pytest.raises(RunError, match=f"cannot write {path}: ."):
        write(path)
    assert path.read_text() == "good"
    assert list(path.parent.iterdir()) == [path]


def test_killed_at_any_change_it_is_the_old_file_or_the_new_one(written):
    path, write = written
    write(path)
    new = path.read_bytes()
    contents = {path.read_bytes() for _ in each_kill(lambda: path.write_text("good"), lambda: write(path))}
    assert contents == {b"good", new}
    write(path)
    assert list(path.parent.iterdir()) == [path], "what killed writers left is gone"


def test_what_another_writer_is_writing_stays(tmp_path):
    path = tmp_path / "a.json"
    with replace_file(path) as theirs:
        theirs.write_text("theirs")
        write_text(path, "mine")
        assert theirs.read_text() == "theirs"
    assert path.read_text() == "theirs"
    assert list(tmp_path.iterdir()) == [path]


def test_a_claim_that_was_given_up_meanwhile_is_claimed_anew(tmp_path, monkeypatch):
    """Another process opens the lock, and locks it after its holder has removed it; a third one comes then."""
    path, lock = tmp_path / "a", fcntl.flock
    first = claim_file(path)
    first.__enter__()

    def later(file: int, operation: int) -> None:
        monkeypatch.setattr(fcntl, "flock", lock)
        first.__exit__(None, None, None)
        lock(file, operation)

    monkeypatch.setattr(fcntl, "flock", later)
    with claim_file(path), pytest.raises(RunError, match="another process writes"), claim_file(path):
        pass
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_is_a_link_is_refused(tmp_path):
    (tmp_path / "precious").mkdir()
    (tmp_path / "figures").symlink_to(tmp_path / "precious")
    with pytest.raises(RunError, match=r"figures: it is a link to .*precious"):
        folder(tmp_path / "figures")


def test_where_no_folder_and_no_lock_can_be_made_it_is_said(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(RunError, match=r"cannot write .*figures: Not a directory"):
        folder(tmp_path / "file" / "figures")
    (tmp_path / ".a.json.lock").mkdir()
    with pytest.raises(RunError, match=r"cannot make .*a\.json\.lock: Is a directory"), lock_file(tmp_path / "a.json"):
        pass


def test_a_copy_of_what_is_not_there_leaves_the_old_file(tmp_path):
    (tmp_path / "b").write_text("good")
    with pytest.raises(RunError, match=r"/a cannot be read: No such file"):
        copy_file(tmp_path / "a", tmp_path / "b")
    assert (tmp_path / "b").read_text() == "good"


def test_an_mp4_that_fails_leaves_the_old_one(tmp_path, monkeypatch):
    (tmp_path / "bin").mkdir()
    program = tmp_path / "bin" / "ffmpeg"
    program.write_text("#!/bin/sh\nexit 1\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path / 'bin'}:{os.environ['PATH']}")
    (tmp_path / "x.mp4").write_text("good")
    with pytest.raises(RunError, match=r"ffmpeg cannot write .*x\.mp4"):
        write_mp4(tmp_path / "x.mp4", [np.zeros((8, 8, 3), np.uint8)] * 2, 0.1)
    assert (tmp_path / "x.mp4").read_text() == "good"


SAVER = """
import sys
from pathlib import Path
from ear_jax.embeddings import ltes
for index in range(int(sys.argv[2])):
    ltes.save(Path(sys.argv[1]), f"{sys.argv[3]}{index}", "vel-1", [[0.6, 0.8, 0.0]], "p")
"""


@pytest.mark.parametrize("count", [20, pytest.param(100, marks=pytest.mark.slow)])
def test_two_processes_that_save_ltes_lose_none(count, tmp_path):
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    processes = [
        subprocess.Popen([sys.executable, "-c", SAVER, str(tmp_path), str(count), name], env=environment)
        for name in ("a", "b")
    ]
    assert [process.wait(120) for process in processes] == [0, 0]
    assert set(ltes.saved(tmp_path)) == {f"{name}{index}" for name in ("a", "b") for index in range(count)}
