"""LTEs that are saved by name: found again for their policy, and refused otherwise."""

from __future__ import annotations

import pytest

from ear_jax.embeddings import ltes
from ear_jax.errors import UsageError


def test_ltes_are_saved_by_name_and_found_again(tmp_path):
    ltes.save(tmp_path, "trot", "vel-3.6", [[0.0, 0.6, 0.8]], "p")
    assert ltes.find(tmp_path, ["trot"], seeds=1, size=3, policy="p") == [[0.0, 0.6, 0.8]]
    assert ltes.find(tmp_path, ["1", "0", "0"], seeds=2, size=3, policy="p") == [[1.0, 0.0, 0.0]] * 2


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["trott"], "did you mean 'trot'"),
        (["1", "0"], "has 2 numbers; this run's LTEs have 3"),
        (["0", "0", "0"], "no direction"),
        (["1", "nan", "0"], "no direction"),
        (["inf", "0", "0"], "no direction"),
        (["1e10", "0", "0"], "no direction; its numbers must be below 1e"),
        (["1", "x", "0"], "neither a name nor 3 numbers"),
    ],
)
def test_bad_ltes_are_one_line(tmp_path, words, complaint):
    ltes.save(tmp_path, "trot", "vel-3.6", [[0.0, 0.6, 0.8]], "p")
    with pytest.raises(UsageError, match=complaint):
        ltes.find(tmp_path, words, seeds=1, size=3, policy="p")


def test_an_lte_cannot_be_named_like_a_number(tmp_path):
    with pytest.raises(UsageError, match="begin with a letter"):
        ltes.save(tmp_path, "3.6", "vel-3.6", [[0.0, 0.6, 0.8]], "p")


def test_a_saved_code_is_of_the_policy_it_was_found_for(tmp_path):
    ltes.save(tmp_path, "trot", "vel-3.6", [[0.0, 0.6, 0.8]], "before")
    with pytest.raises(UsageError, match=r"'trot' was found for another policy, .*--target vel-3.6 --save trot`"):
        ltes.find(tmp_path, ["trot"], seeds=1, size=3, policy="after")
