"""Agents that ship: cards agree with files, names work as runs do, and results stay out of the package."""

from __future__ import annotations

import hashlib
import json
import re
import shutil
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hatchling.builders.wheel import WheelBuilder

from ear_jax import pretrained
from ear_jax.cli import demo, showing
from ear_jax.cli.main import main
from ear_jax.embeddings.interpolate import End, adjacent_pairs, trained_ends
from ear_jax.errors import RunError, UsageError
from ear_jax.runs import records
from ear_jax.runs.export import read_about, read_policy, write_policy
from ear_jax.runs.trained import load
from experiments.inventory import RECORDS
from experiments.publish import ALL_BYTES, FILE_BYTES, among_seeds

NAMES = pretrained.names()
AGENT = Path("pretrained:hopper-vel")


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    """Makes a copy of the agents, which a test may damage."""
    copy = Path(shutil.copytree(pretrained.FOLDER, tmp_path / "agents"))
    monkeypatch.setattr(pretrained, "FOLDER", copy)
    return copy


def contents(directory: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in directory.iterdir() if path.is_file()}


@pytest.mark.parametrize("name", NAMES)
def test_a_card_agrees_with_its_file_which_loads(name):
    card, path = pretrained.card(name), pretrained.find(name)
    content = path.read_bytes()
    assert (card["name"], card["bytes"]) == (name, len(content))
    assert card["sha256"] == hashlib.sha256(content).hexdigest()
    assert len(content) <= FILE_BYTES
    trained = load(Path(f"pretrained:{name}"))
    program, config = trained.program, trained.program.config
    assert (card["family"], card["agent"], card["preset"]) == (config.family, config.agent, config.preset)
    assert card["command"].startswith(f"ear train {config.family}")
    assert card["env_steps"] == trained.env_steps
    assert card["updates"] == trained.epoch * config.sac.updates == card["learning_curve"][-1]["updates"]
    assert [task["name"] for task in card["tasks"]] == program.tasks.names
    assert card["mean_return"] == pytest.approx(np.mean([task["return"] for task in card["tasks"]]), rel=1e-5)
    assert card["commit"] == trained.about["commit"]
    assert card["limits"].endswith(".")


@pytest.mark.parametrize("name", NAMES)
def test_it_is_the_best_seed_that_is_recorded(name):
    card, recorded = pretrained.card(name), {}
    for preset in ("fast", "fast+wide", "fast+gathered", "fast+equivariant"):
        for path in RECORDS.glob(f"{card['family']}-{card['agent']}-{preset}-*/*evaluation.json"):
            seeds = json.loads(path.read_text())["seeds"]
            recorded |= {(path.parent.name, path.name, one["seed"]): one["mean_return"] for one in seeds}
    kind = "refined-evaluation.json" if "refined" in card else "evaluation.json"
    assert recorded[card["record"], kind, card["seed"]] == card["mean_return"] == max(recorded.values())


@pytest.mark.parametrize("name", NAMES)
def test_it_tells_among_how_many_seeds_it_was_chosen(name):
    card = pretrained.card(name)
    found = among_seeds(load(Path(f"pretrained:{name}")), "refined" in card)
    assert found == pytest.approx({key: card[key] for key in ("seeds", "mean_of_seeds")})


def test_a_seed_whose_preset_is_named_otherwise_is_counted_with_the_others():
    """Seed 0 was trained as `fast` with the settings of `fast+wide`."""
    one, other = (
        among_seeds(load(RECORDS / f"ant-dir-ear-fast+wide-seed{seed}" / "policy.safetensors"), refined=False)
        for seed in (0, 1)
    )
    assert one == other
    assert one["seeds"] == 3


def test_there_are_some_and_they_are_small_and_in_the_wheel():
    files = {path.name for path in pretrained.FOLDER.glob("*.safetensors")}
    assert files == {f"{name}.safetensors" for name in NAMES} != set()
    assert sum((pretrained.FOLDER / file).stat().st_size for file in files) <= ALL_BYTES
    root = str(pretrained.FOLDER.parents[1])
    packed = {file.distribution_path for file in WheelBuilder(root).recurse_included_files()}
    assert {f"ear_jax/pretrained/{name}.{kind}" for name in NAMES for kind in ("json", "safetensors")} <= packed


@pytest.mark.parametrize(
    "words",
    [
        "evaluate {}",
        "interpolate {} --all-pairs",
        "compose {} --between 1 2",
        "adapt {} --target 1",
        "map {}",
        "lse {}",
        "render {} --task 1",
        "export {} file.safetensors",
        "demo --pretrained {}",
    ],
)
def test_an_unknown_name_gets_one_line_with_the_nearest(words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(words.format("pretrained:hoper-vel").split()) == 2
    complaint = capsys.readouterr().err
    assert "unknown pretrained agent 'hoper-vel'; did you mean 'hopper-vel'? (there are: " in complaint
    assert complaint.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["", "../pretrained/hopper-vel", "hopper-vel.json", "*"])
def test_a_name_is_no_path(name):
    with pytest.raises(UsageError, match="unknown pretrained agent"):
        load(Path(f"pretrained:{name}"))


def test_results_go_to_the_working_directory(tmp_path, monkeypatch, capsys):
    before = contents(pretrained.FOLDER)
    monkeypatch.chdir(tmp_path)
    assert main(["evaluate", str(AGENT), "--episodes", "1", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["run"] == "pretrained:hopper-vel"
    assert main(["export", str(AGENT), "mine.safetensors"]) == 0
    written = {str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*") if path.is_file()}
    results = "runs/pretrained-hopper-vel"
    evaluated = {f"{results}/evaluation{label}.json" for label in ("", "_episodes-1")}
    assert written == {*evaluated, f"{results}/figures/commanded_achieved_episodes-1.png", "mine.safetensors"}
    assert contents(pretrained.FOLDER) == before


def test_another_file_than_its_cards_is_refused(folder):
    path = folder / "hopper-vel.safetensors"
    content = bytearray(path.read_bytes())
    content[-1] ^= 1
    path.write_bytes(content)
    with pytest.raises(RunError, match=f"{path} is not the file that shipped: its SHA-256 differs"):
        load(AGENT)
    shutil.copyfile(folder / "walker-vel.safetensors", path)
    with pytest.raises(RunError, match="SHA-256 differs"):
        load(AGENT)
    path.unlink()
    with pytest.raises(RunError, match=f"cannot read {path}"):
        load(AGENT)


@pytest.mark.parametrize("content", ["", "[]", "{}", '{"sha256": 1}', "\x80"])
def test_a_broken_card_is_refused_in_one_line(content, folder, capsys):
    (folder / "hopper-vel.json").write_text(content, "latin-1")
    for words in ("evaluate pretrained:hopper-vel", "pretrained", "demo --pretrained hopper-vel"):
        assert main(words.split()) == 1
        assert re.fullmatch(r"ear: \S+hopper-vel.json cannot be read: .*\n", capsys.readouterr().err)


def test_no_code_is_run_because_a_file_says_so(folder, tmp_path):
    """The file and its card agree, and name a Python file as their family."""
    evil, path = tmp_path / "evil.py", folder / "evil.safetensors"
    evil.write_text(f"open({str(tmp_path / 'ran')!r}, 'w')")
    about, header = read_about(folder / "hopper-vel.safetensors")
    arrays = read_policy(folder / "hopper-vel.safetensors", header)
    about["config"]["family"] = f"{evil}:Family"
    write_policy(path, load(AGENT).policies, arrays["codes"], about, "")
    records.write_json(path.with_suffix(".json"), {"sha256": hashlib.sha256(path.read_bytes()).hexdigest()})
    with pytest.raises(UsageError, match=f"to run its code, add --family {evil}:Family"):
        load(Path("pretrained:evil"))
    assert not (tmp_path / "ran").exists()


def test_they_are_listed_with_the_tasks_they_meet(capsys):
    assert main(["pretrained", "--json"]) == 0
    cards = json.loads(capsys.readouterr().out)["pretrained"]
    assert cards == [pretrained.card(name) for name in NAMES]
    assert main(["pretrained"]) == 0
    listed = capsys.readouterr().out
    for card in cards:
        met = [task["met"] for task in card["tasks"] if task["target"] is not None]
        assert re.search(f"^{card['name']} +ear .* {sum(met)} of {len(met)}$", listed, re.MULTILINE)


def test_the_demo_plays_a_blend_between_its_ends(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(showing, "EPISODES", 2)
    monkeypatch.setattr(showing, "SEARCH_EPISODES", 1)
    assert main(["demo", "--pretrained", "hopper-vel", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    first, blend, second = document["rows"]
    assert (first["beta"], second["beta"]) == (1, 0)
    assert first["commanded"] < blend["commanded"] < second["commanded"]
    assert 0 < blend["beta"] < 1
    assert abs(blend["achieved"] - blend["commanded"]) < 0.05
    assert document["figures"] == ["runs/pretrained-hopper-vel/figures/demo.png"]
    assert [str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*.*")] == document["figures"]


def test_without_a_name_the_demo_takes_the_cheetah_or_the_first(monkeypatch):
    for names, expected in (
        (["ant-dir", "halfcheetah-vel"], "halfcheetah-vel"),
        (["ant-dir", "hopper-vel"], "ant-dir"),
    ):
        monkeypatch.setattr(pretrained, "names", lambda names=names: names)
        assert demo.default_agent() == expected


@pytest.mark.parametrize("name", NAMES)
def test_the_demo_finds_two_neighbours_to_blend_for_every_agent(name):
    trained = load(Path(f"pretrained:{name}"))
    pairs = adjacent_pairs(trained_ends(trained), trained.program.family)
    card = pretrained.card(name)
    met = {task["name"] for task in card["tasks"] if task.get("met")}
    assert {end.name for end in showing.best_pair(pairs, card)} <= met


def test_the_demo_takes_neighbours_that_are_met():
    ends = [End(name, target, np.zeros((1, 3))) for name, target in (("a", 1.0), ("b", 2.0), ("c", 3.0), ("d", 4.0))]
    pairs = list(pairwise(ends))
    tasks = [
        {"name": name, "error": error, "met": name != "b"} for name, error in zip("abcd", (0, 0, 0.2, 0.1), strict=True)
    ]
    assert showing.best_pair(pairs, {"name": "x", "tasks": tasks}) == pairs[2]
    unknown = [{"name": name, "return": 1.0} for name in "abcd"]
    assert showing.best_pair(pairs, {"name": "x", "tasks": unknown}) == pairs[0]
    with pytest.raises(UsageError, match="x has no two tasks to blend"):
        showing.best_pair([], {"name": "x", "tasks": tasks})


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        ("demo --pretrained a b", "names 2 agents; name one"),
        ("demo --pretrained hopper-vel --out x", "--out applies only to training"),
        ("pretrained hopper-vel", "'hopper-vel' is one word too many"),
        ("evaluate hopper-vel", "did you mean pretrained:hopper-vel?"),
    ],
)
def test_a_mistake_gets_one_clear_line(words, complaint, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(words.split()) == 2
    error = capsys.readouterr().err
    assert complaint in error
    assert error.count("\n") == 1
