"""Runs from their records: which are one group, and a group's curves on one axis."""

from __future__ import annotations

import numpy as np
import pytest

from ear_jax.errors import RunError, UsageError
from ear_jax.files.rows import append_rows
from ear_jax.runs.groups import band, curve, group, read, two_groups
from tests.helpers.records_of import write_records


def rows(*values: float) -> list[dict[str, float]]:
    return [{"vel-1": value, "vel-2": value + 10} for value in values]


def test_runs_that_differ_only_in_seeds_are_one_group(tmp_path):
    places = [
        write_records(tmp_path / "one-seed0", {0: rows(1)}),
        write_records(tmp_path / "other-seeds0-1", {0: rows(5), 1: rows(6)}, agent="onehot"),
        write_records(tmp_path / "one-seed1", {1: rows(2)}, engine="mjx"),
    ]
    groups = group(map(read, places))
    assert [(members.name, len(members.seeds)) for members in groups] == [("one", 2), ("other", 2)]


def test_the_same_seed_again_is_a_curve_of_its_own(tmp_path):
    places = [write_records(tmp_path / place / "one-seed0", {0: rows(1)}) for place in "ab"]
    assert [members.name for members in group(map(read, places))] == [str(place) for place in places]


def test_a_curve_is_by_updates_steps_or_minutes(tmp_path):
    (own,) = read(write_records(tmp_path / "run", {0: rows(3, 4)})).seeds.values()
    for by, places in (("updates", [400, 800]), ("steps", [1000, 2000]), ("minutes", [0.5, 1.0])):
        np.testing.assert_allclose(curve(own, "vel-2", by), (places, [13, 14]))
    np.testing.assert_allclose(curve(own, "mean_return", "updates")[1], [8, 9])
    with pytest.raises(UsageError, match="did you mean 'entropy'"):
        curve(own, "entrpy", "updates")


def test_a_band_covers_what_all_seeds_cover(tmp_path):
    """The second seed stops at half of the first one's updates."""
    run = read(write_records(tmp_path / "run", {0: rows(0, 2, 4, 6), 1: rows(10, 20)}))
    (members,) = group([run])
    places, values = band(members, "vel-1", "updates")
    np.testing.assert_allclose(places, [400, 800])
    np.testing.assert_allclose(values, [[0, 2], [10, 20]])


def test_seeds_with_other_clocks_are_interpolated(tmp_path):
    run = read(write_records(tmp_path / "run", {0: rows(0, 2), 1: rows(10, 20)}))
    for row in run.seeds[1]:
        row["seconds"] += 15
    places, values = band(group([run])[0], "vel-1", "minutes")
    np.testing.assert_allclose(places, [0.75, 1.0])
    np.testing.assert_allclose(values, [[1, 2], [10, 15]])


def test_what_cannot_be_grouped_is_refused(tmp_path):
    run = write_records(tmp_path / "run", {0: rows(1)})
    with pytest.raises(UsageError, match="is given twice"):
        two_groups([run], [run])
    (run / "metrics.jsonl").write_text("")
    with pytest.raises(UsageError, match="has no row of metrics yet"):
        read(run)


@pytest.mark.parametrize(("row", "lacking"), [({"epoch": 20}, "seed"), ({"seed": 0, "epoch": 20}, "env_steps")])
def test_rows_that_lack_a_key_are_named(row, lacking, tmp_path):
    run = write_records(tmp_path / "run", {0: rows(1)})
    append_rows(run / "metrics.jsonl", [row])
    with pytest.raises(RunError, match=rf"metrics\.jsonl is damaged: line 2: its '{lacking}' is missing"):
        read(run)
