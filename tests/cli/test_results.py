"""The last steps of a command: files in the run's directory, text or one JSON document, and early ends."""

from __future__ import annotations

import dataclasses
import json
import subprocess
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest

from ear_jax.cli.completion import commands
from ear_jax.cli.evaluate import ended_early
from ear_jax.cli.explore import name as explore_name
from ear_jax.cli.on_run import OnRun
from ear_jax.cli.results import UNLABELLED, keep, label_of, show_and_keep
from ear_jax.errors import RunError
from ear_jax.runs import records


@pytest.mark.parametrize("names", [[], ["a.png", "b.png"]])
def test_a_document_is_kept_with_its_provenance_and_printed_without(tmp_path, names, capsys):
    document = {"answer": 42}

    def kept() -> list[Path]:
        return keep(tmp_path, "document", "_x", document, lambda figures, _, label: [figures / name for name in names])

    pictures = [tmp_path / "figures" / name for name in names]
    show_and_keep(document, True, print, kept)
    assert json.loads(capsys.readouterr().out) == {"answer": 42, "figures": [str(path) for path in pictures]}
    found = json.loads((tmp_path / "document_x.json").read_text())
    assert found["answer"] == 42
    assert {"machine", "versions", "commit"} < set(found)
    show_and_keep(document, False, lambda document: print(document["answer"]), kept)
    listed = ["pictures: " + ", ".join(map(str, pictures))] if names else []
    assert capsys.readouterr().out.splitlines() == ["42", *listed]


@pytest.mark.parametrize(
    "fault",
    [RunError("cannot write /run: Permission denied"), PermissionError(13, "Permission denied"), OSError(28, "x")],
)
@pytest.mark.parametrize("as_json", [False, True])
def test_results_that_cannot_be_kept_are_shown_with_a_warning(fault, as_json, capsys):
    def refuse() -> list[Path]:
        assert as_json or capsys.readouterr().out == "42\n", "shown first"
        raise fault

    show_and_keep({"answer": 42}, as_json, lambda document: print(document["answer"]), refuse)
    streams = capsys.readouterr()
    assert streams.err.startswith("warning: these results are not kept: ")
    assert streams.out == ('{"answer": 42, "figures": []}\n' if as_json else "")


@dataclass(frozen=True)
class Command:
    """A command's options, as `label_of` reads them."""

    run: str
    seed: int = 0
    between: tuple[str, str] | None = None
    beta: tuple[float, ...] = ()
    all_pairs: bool = False
    target: float | None = None
    json: bool = False


def test_results_are_kept_though_their_reader_has_left():
    kept = []

    def left(_: Any) -> None:
        raise BrokenPipeError

    with pytest.raises(BrokenPipeError):
        show_and_keep({"answer": 42}, False, left, lambda: kept.append("kept") or [])
    assert kept == ["kept"]


def test_outputs_of_other_options_have_other_names():
    """Every option but those that change nothing is in the name, and equal options give equal names."""
    others = [
        Command("b"),
        Command("b", seed=5),
        Command("b", between=("2", "3")),
        Command("b", between=("3", "2")),
        Command("b", between=("2", "3"), target=2.5),
        Command("b", between=("2", "3"), target=2.50001),
        Command("b", all_pairs=True),
        Command("b", beta=(0.5,)),
        *(Command("b", beta=(*range(100), last)) for last in (100, 101)),
        *(Command("b", between=(name, "x")) for name in ("a/b", "../b")),
    ]
    labels = [label_of(command) for command in others]
    assert labels[:5] == ["", "_random-5", "_between-2-3", "_between-3-2", "_between-2-3_target-2.5"]
    assert len(set(labels)) == len(others)
    assert all(len(label) < 120 and "/" not in label for label in labels)
    assert labels == [label_of(replace(command, run="c", json=True)) for command in others]


def instance(kind: Any) -> Any:
    """Returns a command with its required options."""
    required = {"run": Path("a"), "between": ("1", "2")}
    fields = {field.name for field in dataclasses.fields(kind)}
    return kind(**{name: value for name, value in required.items() if name in fields})


def other(value: Any) -> Any:
    """Returns another value of an option."""
    return {bool: not value, int: 77, float: 77.0, tuple: ("7", "8")}.get(type(value), "x")


# The results of `ear refine` are about a new file, and in a folder named after it.
KEPT = [name for name, kind in commands().items() if issubclass(kind, OnRun) and name != "refine"]


@pytest.mark.parametrize("name", KEPT)
def test_every_option_that_changes_a_result_is_in_its_name(name):
    command = instance(commands()[name])
    fields = [field.name for field in dataclasses.fields(command) if field.name not in (*UNLABELLED, "all", "open")]
    changed = [replace(command, **{field: other(getattr(command, field))}) for field in fields]
    of = explore_name if name == "explore" else label_of
    names = [of(one) for one in (command, *changed)]
    if name == "explore":  # which names the policy by its seed
        names[1 + fields.index("policy")] = explore_name(command, "seed1")
    assert len(set(names)) == len(names), dict(zip(("", *fields), names, strict=True))


def test_what_a_name_tells_already_is_not_repeated():
    assert label_of(Command("b", between=("2", "3"), seed=1), without=("between",)) == "_random-1"


@pytest.mark.parametrize(
    ("failures", "line"),
    [
        ([[0, 0]], "All 6 episodes ran their 200 steps"),
        ([[0, 2]], "Episodes ended early in 1 of 2 tasks: vel-2 2 of 3"),
        (
            [[1, 0], [0, 3]],
            "Episodes ended early in 2 of 4 tasks: vel-1 (seed 7) 1 of 3, vel-2 (seed 8) 3 of 3",
        ),
        (
            [[2] * 40],
            f"Episodes ended early in 40 of 40 tasks: {', '.join(f'vel-{task} 2 of 3' for task in range(1, 31))}, "
            "and 10 more tasks",
        ),
    ],
)
def test_tasks_with_episodes_that_ended_early_are_named(failures, line):
    seeds = [
        {
            "seed": 7 + row,
            "tasks": [{"name": f"vel-{task + 1}", "failures": count} for task, count in enumerate(counts)],
        }
        for row, counts in enumerate(failures)
    ]
    assert ended_early({"episodes": 3, "episode_length": 200, "seeds": seeds}) == line


def test_the_commit_of_a_project_in_which_ear_jax_is_installed_is_not_ours(tmp_path, monkeypatch):
    package = tmp_path / ".venv" / "ear_jax" / "runs"
    package.mkdir(parents=True)
    (tmp_path / "mine.py").touch()
    identity = ("-c", "user.name=a", "-c", "user.email=a@b.example")
    for words in (["init", "-q"], ["add", "mine.py"], [*identity, "commit", "-qm", "mine"]):
        subprocess.run(["git", "-C", tmp_path, *words], check=True)
    monkeypatch.setattr(records, "__file__", str(package / "records.py"))
    (package / "records.py").touch()
    assert records.commit.__wrapped__() is None
