"""Comparisons of runs: settings that differ, the returns they use, and statistics worked out by hand."""

from __future__ import annotations

import json

import pytest

from ear_jax.errors import RunError, UsageError
from ear_jax.runs import records
from ear_jax.runs.comparison import EVALUATIONS, LAST_ROWS, compare
from ear_jax.runs.groups import two_groups
from tests.helpers.records_of import write_records


def evaluate(run, updates, **returns):
    """Writes an evaluation in which every seed returns the same on both tasks."""
    seeds = [
        {"seed": int(seed.removeprefix("seed")), "tasks": [{"name": name, "return_mean": value} for name in ("a", "b")]}
        for seed, value in returns.items()
    ]
    records.write_json(run / EVALUATIONS, {"updates": updates, "episodes": 20, "seeds": seeds})


@pytest.fixture
def pair(tmp_path):
    """The first beats the second on task a in 3 of 4 pairs of seeds, and always on task b; a third task is its own."""
    one = write_records(tmp_path / "one-seeds0-1", {0: [{"a": 1, "b": 9, "c": 0}], 1: [{"a": 3, "b": 8, "c": 0}]})
    other = write_records(tmp_path / "other-seeds0-1", {0: [{"a": 2, "b": 1}], 1: [{"a": 0, "b": 2}]}, agent="onehot")
    return one, other


def test_statistics_by_hand(pair):
    document = compare(*two_groups(pair[:1], pair[1:]))
    assert document["settings"] == [{"name": "agent", "values": ["ear", "onehot"]}]
    assert (document["returns_from"], document["tasks"]) == (LAST_ROWS, ["a", "b"])
    first, second = document["groups"]
    assert (first["name"], first["mean"]["value"], first["interquartile_mean"]["value"]) == ("one", 5.25, 5.5)
    assert (second["returns"], second["mean"]["value"]) == ([[2, 1], [0, 2]], 1.25)
    assert [first["episodes"], second["episodes"]] == [3, 3]
    chance = document["probability_of_improvement"]
    assert chance["value"] == pytest.approx((3 / 4 + 1) / 2)
    assert 0 <= chance["interval"][0] < chance["value"] < chance["interval"][1] <= 1
    json.dumps(document, allow_nan=False)


def test_evaluations_of_the_last_policies_come_before_metrics(pair):
    evaluate(pair[0], 400, seed0=5.0, seed1=7.0)
    assert compare(*two_groups(pair[:1], pair[1:]))["returns_from"] == LAST_ROWS
    evaluate(pair[1], 400, seed0=1.0, seed1=6.0)
    document = compare(*two_groups(pair[:1], pair[1:]))
    assert document["returns_from"] == EVALUATIONS
    assert document["groups"][0]["returns"] == [[5, 5], [7, 7]]
    assert document["groups"][0]["episodes"] == 20
    assert document["probability_of_improvement"]["value"] == pytest.approx(3 / 4)
    evaluate(pair[1], 200, seed0=1.0, seed1=6.0)  # of an earlier policy
    assert compare(*two_groups(pair[:1], pair[1:]))["returns_from"] == LAST_ROWS


def test_one_seed_has_no_interval_and_other_tasks_no_comparison(pair, tmp_path):
    alone = write_records(tmp_path / "alone", {0: [{"a": 1}]})
    document = compare(*two_groups([alone], pair[1:]))
    assert document["tasks"] == ["a"]
    assert document["groups"][0]["mean"] == {"value": 1.0, "interval": None}
    assert document["probability_of_improvement"] == {"value": 0.5, "interval": None}
    with pytest.raises(UsageError, match="no task in common"):
        compare(*two_groups([write_records(tmp_path / "elsewhere", {0: [{"z": 1}]})], pair[1:]))


@pytest.mark.parametrize("document", [{}, {"seeds": [1]}, {"seeds": [{"seed": 0, "tasks": [{}]}], "updates": 1}])
def test_an_evaluation_that_lacks_a_key_is_named(document, pair):
    records.write_json(pair[0] / EVALUATIONS, document)
    with pytest.raises(RunError, match=rf"{EVALUATIONS} cannot be read: "):
        compare(*two_groups(pair[:1], pair[1:]))
