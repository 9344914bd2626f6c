"""What benchmarks conclude from rows, on rows with known answers. Their timings are no tests."""

from __future__ import annotations

from benchmarks.time_to_return import passed


def test_a_mark_is_passed_by_three_evaluations_in_a_row():
    rows = [{"mean_return": value, "updates": index} for index, value in enumerate((0, 9, 0, 4, 6, 5, 1))]
    assert passed(rows, 5)["updates"] == 5, "of 4, 6 and 5 the mean is 5; the lucky 9 counts for nothing alone"
    assert passed(rows, 3)["updates"] == 2, "0, 9 and 0"
    assert passed(rows, 5.1) is None
    assert passed(rows[:2], 0) is None
