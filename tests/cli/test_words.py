"""The words of the command line: mistakes cost no import of JAX, guesses are near, and help is complete."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from ear_jax import __version__, names
from ear_jax.cli.arguments import parse
from ear_jax.cli.completion import commands
from ear_jax.cli.main import COMMANDS, SYNONYMS, main
from ear_jax.envs import FAMILIES
from ear_jax.methods import METHODS
from ear_jax.presets import draft_config, preset_config
from ear_jax.runs import records

MISTAKES = {
    "play": "unknown command 'play'; did you mean 'render' or 'evaluate' or 'explore'?",
    "resume": "did you mean 'train'? (the same `ear train` command continues a run)",
    "xyzzy": "unknown command 'xyzzy' (there are: adapt",
    "evaluate nowhere": "nowhere is not a run directory",
    "evaluate pretrained:Hoper-Vel": "did you mean 'hopper-vel'?",
    "evaluate pretrained:hopper-vel --engine cuda": "'cuda' (there are: auto, mjx, mjx-fixed, native, warp)",
    "evaluate pretrained:hopper-vel --episode 3": "unknown option --episode; did you mean --episodes?",
    "evaluate pretrained:hopper-vel -episodes 3": "unknown option -episodes; did you mean --episodes?",
    "evaluate pretrained:hopper-vel --episodes 1.5": "--episodes takes a whole number, not '1.5'",
    "evaluate pretrained:hopper-vel --seed": "--seed needs a whole number",
    "evaluate a b": "'b' is one word too many",
    "export pretrained:hopper-vel": "FILE is missing: the new file, which must end in .safetensors",
    "interpolate pretrained:hopper-vel --between 2": "--between takes 2 values, A B, not '2'",
    "interpolate pretrained:hopper-vel --between 1 2 --beta x": "--beta takes numbers, not 'x'",
    "interpolate pretrained:hopper-vel --along x": "--along takes chord or arc, not 'x'",
    "render pretrained:hopper-vel --film": "unknown option --film; did you mean --no-film?",
    "render pretrained:hopper-vel --task": "--task needs at least one value",
    "train hopper": "unknown family 'hopper'; did you mean 'hopper-vel'?",
    "train nowhere.py:Mine": "no file nowhere.py; name your own family as path/to/file.py:ClassName",
    "train hopper-vel --lr 3e-4": "unknown option --lr; did you mean --sac.lr?",
    "train hopper-vel --epo 3": "unknown option --epo; did you mean --epochs?",
    "train hopper-vel --discount 1": "did you mean --sac.discount or --maml.discount?",
    "train hopper-vel --batch_size 3": "did you mean --sac.batch-size?",
    "train hopper-vel --preset fst": "unknown preset 'fst'; did you mean 'fast'?",
    "train hopper-vel --preset fast+wid": "unknown preset variant 'wid'; did you mean 'wide'?",
    "train hopper-vel --agent ppo": "unknown agent 'ppo' (there are: ear, ear-rnn, maml, multihead, onehot, ",
    "train hopper-vel --sac.lr 7": "--sac.lr 7.0 is out of range",
    "train hopper-vel --sac.lr x": "--sac.lr takes a number, not 'x'",
    "train hopper-vel --minutes inf": "--minutes inf is out of range; it must be finite",
    "train ant-dir --env.lateral-weight nan": "--env.lateral-weight nan is out of range; it must be finite",
    "explore --all --replay": "--replay, --policy and --family go with a RUN and not with --all",
    "families fam.py": "fam.py names no class; name your own family as fam.py:",
    "demo --pretrained a b": "names 2 agents; name one",
}


def test_mistakes_are_refused_before_jax_is_imported(tmp_path):
    """All in one process, in which JAX cannot be imported."""
    code = f"""
import sys
sys.modules["jax"] = None
from ear_jax.cli.main import main
for line in {list(MISTAKES)!r}:
    assert main(line.split()) == 2, line
"""
    (tmp_path / "fam.py").write_text("import jax\n")
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, ""), done.stderr
    lines = done.stderr.splitlines()
    assert len(lines) == len(MISTAKES)
    for line, complaint in zip(lines, MISTAKES.values(), strict=True):
        assert line.startswith("ear: ")
        assert complaint in line


def test_commands_are_parsed_without_the_slow_imports():
    code = f"import sys\nfor name in {[module for module, _ in COMMANDS.values()]!r}: __import__(name)\n"
    code += "print([name for name in ('jax', 'mujoco', 'matplotlib', 'orbax') if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


@pytest.mark.parametrize("words", [["--version"], ["-V"], ["version"]])
def test_the_version_is_told(words, capsys):
    assert main(words) == 0
    assert capsys.readouterr().out == f"ear_jax {__version__}\n"
    assert records.provenance()["versions"]["ear_jax"] == __version__


def test_help_may_be_asked_for_in_three_ways(capsys):
    printed = []
    for words in (["help"], ["--help"], []):
        main(words)
        printed.append(capsys.readouterr().out)
    assert printed[0] == printed[1] == printed[2]
    assert all(f"  {name} " in printed[0] for name in COMMANDS)
    assert main(["help", "export"]) == main(["export", "--help"]) == main(["Export", "-h"]) == 0
    first, second, third = capsys.readouterr().out.split("usage: ")[1:]
    assert first == second == third


def test_synonyms_mean_commands():
    assert {command for meant in SYNONYMS.values() for command in meant} <= set(COMMANDS)
    assert not set(SYNONYMS) & set(COMMANDS)


@pytest.mark.parametrize("name", COMMANDS)
def test_help_says_what_each_option_takes_and_gives_an_example_that_parses(name, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    assert main([name, "--help"]) == 0
    text = capsys.readouterr().out
    assert not re.findall(r"\{None\}|\(default: \)|default: None|STR", text)
    (example,) = re.findall(r"^Example: (.*)$", text, re.MULTILINE)
    program, command, *words = shlex.split(example)
    assert (program, command) == ("ear", name)
    if name in commands():
        parse(commands()[name], words, name)


def test_names_are_those_of_files():
    assert tuple(FAMILIES) == names.FAMILIES
    assert tuple(METHODS) == names.METHODS
    assert all(family.name == name for name, family in FAMILIES.items())
    assert all(method.name == name for name, method in METHODS.items())


def test_help_without_jax_shows_the_defaults_with_it():
    assert draft_config("halfcheetah-vel", "fast") == preset_config("halfcheetah-vel", "fast")


def test_a_path_may_begin_at_the_users_home(monkeypatch):
    monkeypatch.setenv("HOME", "/home/me")
    assert parse(commands()["demo"], ["--out=~/run"], "demo").out == Path("/home/me/run")
    assert parse(commands()["export"], ["~/run", "~/x.safetensors"], "export").file == Path("/home/me/x.safetensors")
    assert parse(commands()["demo"], ["--out", "~nobody-here/run"], "demo").out == Path("~nobody-here/run")
