"""Run directories damaged at random: every command ends soon, in one line or with a result, and nothing is followed."""

from __future__ import annotations

import random
import shutil
from pathlib import Path

import pytest

from tests.helpers.runs import finished_config, words
from tests.helpers.stubs import COMPUTES, check, stub

COMMANDS = ("evaluate", "interpolate", "adapt", "map", "lse", "plot", "compare", "log", "export", "train", "config")
GARBAGE = (b"", b"{", b"[]\n", b"null", b"3\n", b"[" * 100_000, b'{"config": [1]}', b"\xff\x00\xfe" * 99, b"NaN\n")


def damage(run: Path, dice: random.Random) -> str:
    """Damages one file or directory of a run, and says how."""
    paths = sorted(path for path in run.rglob("*") if path.name != "lock")
    path = dice.choice([run / "config.json", run / "metrics.jsonl", run / "checkpoints", *paths])
    kind = dice.choice(("gone", "garbage", "short", "flipped", "folder", "dangling", "elsewhere", "twice"))
    if path.is_dir() or kind in ("gone", "folder", "dangling", "elsewhere"):
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)
    if kind == "folder":
        path.mkdir(parents=True)
    elif kind == "dangling":
        path.symlink_to(run / "nowhere")
    elif kind == "elsewhere":
        path.symlink_to(run.parent / "precious")
    elif path.is_file():
        content = bytearray(path.read_bytes())
        changed = {"garbage": dice.choice(GARBAGE), "short": content[: len(content) // 2], "twice": content * 2}
        if kind == "flipped" and content:
            content[dice.randrange(len(content))] ^= 1 << dice.randrange(8)
        path.write_bytes(changed.get(kind, content))
    return f"{path.relative_to(run)} {kind}"


def command_line(name: str, run: Path, dice: random.Random) -> list[str]:
    """Returns a command that reads, continues or writes a run."""
    options = {
        "adapt": ["--target", "2"],
        "compare": [str(run.parent / "good")],
        "log": ["--tensorboard"],
        "export": [str(run.parent / "policy.safetensors")],
    }
    if name == "train":
        return [*words(finished_config(epochs=dice.choice((24, 26)))), "--out", str(run)]
    if name == "config":
        return ["train", "--config", str(run), "--dry-run"]
    return [name, str(run), *options.get(name, [])]


SEEDS = [(0, 8), *(pytest.param(seed, 20, marks=pytest.mark.slow) for seed in range(1, 11))]


@pytest.mark.parametrize(("seed", "runs"), SEEDS)
def test_every_command_ends_in_one_line(seed, runs, finished, tmp_path, monkeypatch, capsys):
    stub(monkeypatch, (*COMPUTES, "ear_jax.runs.on_host.compile_program"))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "precious").write_text("mine")
    shutil.copytree(finished, tmp_path / "good")
    dice = random.Random(seed)
    for number in range(runs):
        run = Path(shutil.copytree(finished, tmp_path / f"run{number}"))
        damages = [damage(run, dice) for _ in range(dice.choice((1, 1, 2, 3)))]
        for name in dice.sample(COMMANDS, 2):
            try:
                check(command_line(name, run, dice), capsys)
            except BaseException as error:
                pytest.fail(f"{name} after {damages}: {type(error).__name__}: {error}")
        assert (tmp_path / "precious").read_text() == "mine", damages
        shutil.rmtree(run)
