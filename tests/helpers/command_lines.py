"""Random command lines: real commands and flags with values that are right, wrong, mistyped, huge, empty or odd."""

from __future__ import annotations

import random
from pathlib import Path

from ear_jax.cli.completion import commands
from ear_jax.cli.flags import Flag, flags_of
from ear_jax.cli.main import COMMANDS, SYNONYMS

RUNS = ("nowhere", "folder", "file", "broken", "torn.safetensors", "pretrained:hopper-vel", "pretrained:Hopper-Vel")
RUNS += ("pretrained:", "pretrained:../x", "/proc/self/mem", "/dev/null", "~", "~nobody/x", "", ".", "a\tb")
NUMBERS = (
    "0",
    "1",
    "3",
    "-1",
    "2.5",
    "1e-3",
    "1e400",
    "nan",
    "-inf",
    "1_000",
    "٣",
    "0x10",
    "99999999999999999999",
    "3,5",
)
ODD = (
    "",
    " ",
    "--",
    "-",
    "=",
    "[/x]",
    ":smile:",
    "β",
    "\udcff",
    "x" * 5000,
    "$(x)",
    "'",
    "%s",
    "{}",
    "None",
    "\x1b[31m",
)
NAMES = ("vel-1", "1.8", "2", "vel-99", "fast", "FAST", "smoke+wide", "fast+", "ear", "EAR", "maml", "native", "mjxx")
FAMILIES = (
    "halfcheetah-vel",
    "HalfCheetah-Vel",
    "hopper-vel",
    "hoper-vel",
    "reach",
    "fam.py",
    "fam.py:Mine",
    ":",
    "x:y",
)


def command_line(dice: random.Random) -> list[str]:
    """Returns the words of a random command line, most of which are right."""
    kinds = commands()
    name = dice.choice([*kinds]) if dice.random() < 0.93 else dice.choice([*COMMANDS, *SYNONYMS, "help", "-h", *ODD])
    flags = list(flags_of(kinds[name]).values()) if name in kinds else []
    words = [name, *_positional(name, dice)]
    for _ in range(dice.choice((0, 1, 1, 2, 3, 5))):
        words += _option(dice, flags)
    if dice.random() < 0.04:
        dice.shuffle(words)
    return words


def make_places(here: Path) -> None:
    """Makes the files and directories that `command_line` names."""
    (here / "folder").mkdir()
    (here / "file").write_bytes(b"\x00\xff")
    (here / "broken").mkdir()
    (here / "broken" / "config.json").write_text('{"config": {"family": "hopper-vel", "agent": 3}}')
    (here / "broken" / "metrics.jsonl").write_text("[]\n3\n{\n")
    (here / "torn.safetensors").write_bytes(b"\x10\0\0\0\0\0\0\0{}")
    (here / "fam.py").write_text("class Mine(Family): pass\n")


def _positional(name: str, dice: random.Random) -> list[str]:
    wanted = {"export": 2, "compare": 2, "demo": 0, "pretrained": 0, "doctor": 0}.get(name, 1)
    count = wanted if dice.random() < 0.92 else dice.choice((0, 1, 2, 3))
    families = name in ("train", "sweep", "config", "families")
    right = ("halfcheetah-vel", "hopper-vel", "HalfCheetah-Vel") if families else ("pretrained:hopper-vel",)
    pool = right if dice.random() < 0.75 else FAMILIES if families else RUNS
    runs = [dice.choice(pool) for _ in range(count)]
    return [*runs[:-1], "x.safetensors"] if name == "export" and dice.random() < 0.9 else runs


def _option(dice: random.Random, flags: list[Flag]) -> list[str]:
    """Returns a flag, rarely a mistyped one, with values that it takes, or else any others."""
    if not flags or dice.random() < 0.04:
        return [dice.choice(("--lr", "--epo", "--help", "-x", "--"))]
    flag = dice.choice(flags)
    name, values = flag.name, _values(dice, flag)
    if dice.random() < 0.3:
        pool = dice.choice((NUMBERS, NUMBERS, NAMES, NAMES, ODD, RUNS, FAMILIES))
        values = [dice.choice(pool) for _ in range(dice.choice((0, 1, 1, 1, 2, 3)))]
    if dice.random() < 0.05:
        position = dice.randrange(len(name))
        name = name[:position] + dice.choice("a-.=_") + name[position + 1 :]
    return [f"{name}={values[0]}", *values[1:]] if values and dice.random() < 0.2 else [name, *values]


def _values(dice: random.Random, flag: Flag) -> list[str]:
    """Returns values of the kind that a flag takes."""
    if flag.is_switch:
        return []
    if flag.takes in ("a whole number", "whole numbers"):
        return [str(dice.choice((0, 1, 2, 7, 100, 10**9, 10**15, -1)))]
    if flag.takes in ("a number", "numbers"):
        return [str(dice.choice((0.0, 0.5, 1.0, 2.5, -1.0, 1e300)))]
    if flag.takes == "true or false":
        return [dice.choice(("true", "False"))]
    if " or " in flag.takes:
        return [dice.choice(flag.takes.replace(" or ", ", ").split(", "))]
    return [dice.choice(NAMES) for _ in range(2 if flag.takes.startswith("2") else 1)]
