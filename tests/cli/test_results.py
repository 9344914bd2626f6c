"""The last steps of a command: files in the run's directory, text or one JSON document, and falls in one line."""

from __future__ import annotations

import json

import pytest

from ear_jax.cli.evaluate import falls
from ear_jax.cli.results import keep, print_result


@pytest.mark.parametrize("names", [[], ["a.png", "b.png"]])
def test_a_document_is_kept_with_its_provenance_and_printed_without(tmp_path, names, capsys):
    document = {"answer": 42}
    pictures = keep(tmp_path, "document.json", document, lambda figures, _: [figures / name for name in names])
    assert pictures == [tmp_path / "figures" / name for name in names]
    kept = json.loads((tmp_path / "document.json").read_text())
    assert kept["answer"] == 42
    assert {"machine", "versions", "commit"} < set(kept)
    print_result(document, pictures, True, print)
    assert json.loads(capsys.readouterr().out) == {"answer": 42, "figures": [str(path) for path in pictures]}
    print_result(document, pictures, False, lambda document: print(document["answer"]))
    listed = ["pictures: " + ", ".join(map(str, pictures))] if names else []
    assert capsys.readouterr().out.splitlines() == ["42", *listed]


@pytest.mark.parametrize(
    ("failures", "line"),
    [
        ([[0, 0]], "No falls: all 6 episodes ran their 200 steps"),
        ([[0, 2]], "1 of 2 tasks had falls: vel-2 in 2 of 3 episodes"),
        (
            [[1, 0], [0, 3]],
            "2 of 4 tasks had falls: vel-1 (seed 7) in 1 of 3 episodes, vel-2 (seed 8) in 3 of 3 episodes",
        ),
    ],
)
def test_falls_are_named(failures, line):
    seeds = [
        {
            "seed": 7 + row,
            "tasks": [{"name": f"vel-{task + 1}", "failures": count} for task, count in enumerate(counts)],
        }
        for row, counts in enumerate(failures)
    ]
    assert falls({"episodes": 3, "episode_length": 200, "seeds": seeds}) == line
