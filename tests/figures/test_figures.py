"""Figures of interpolation and of search: their lines show the documents' numbers."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.axes import Axes

from ear_jax.figures import adapt, evaluate, interpolate

QUANTITY = {"outcome": "velocity", "unit": "m/s"}


@pytest.fixture
def drawn(monkeypatch):
    """Collects every line of all figures as (x, y), in drawing order."""
    lines, plot = [], Axes.plot

    def note(axes, *arguments, **style):
        made = plot(axes, *arguments, **style)
        lines.extend((line.get_xdata().tolist(), line.get_ydata().tolist()) for line in made)
        return made

    monkeypatch.setattr(Axes, "plot", note)
    return lines


def pair(seed, first, second, curve):
    return {"seed": seed, "between": [first, second], "target": 1.5, "beta": 0.25, "outcome": 1.4, "curve": curve}


def test_pairs_stand_side_by_side_each_from_its_first_task(tmp_path, drawn):
    pairs = [pair(seed, f"vel-{one}", f"vel-{one + 1}", [1.9, 1.5, 1.1]) for seed in (3, 4) for one in (1, 2)]
    document = {"pairs": pairs, "betas": [0.1, 0.5, 0.9], "commanded": QUANTITY}
    pictures = interpolate.draw_interpolate(tmp_path / "figures", document)
    assert [picture.name for picture in pictures] == ["interpolation_seed3.png", "interpolation_seed4.png"]
    assert all(picture.stat().st_size > 5_000 for picture in pictures)
    curve, best, next_curve, next_best = drawn[:4]
    np.testing.assert_allclose(curve, ([0.9, 0.5, 0.1], [1.9, 1.5, 1.1]))
    np.testing.assert_allclose(best, ([0.75], [1.4]))
    np.testing.assert_allclose(next_curve[0], [1.9, 1.5, 1.1])
    np.testing.assert_allclose(next_best[0], [1.75])


def test_betas_asked_for_are_a_line_a_pair_in_their_order(tmp_path, drawn):
    rows = [
        {"seed": 0, "between": between, "beta": beta, "outcome": 10 * beta}
        for between in (["a", "b"], ["b", "c"])
        for beta in (1.8, -0.2)
    ]
    (picture,) = interpolate.draw_interpolate(tmp_path, {"blends": rows, "commanded": QUANTITY})
    assert picture.name == "interpolation_seed0.png"
    assert drawn == [([-0.2, 1.8], [-2, 18])] * 2


def test_a_run_without_commands_has_no_figure_of_them(tmp_path):
    task = {"target": None, "episodes": {"velocity": [1.0]}}
    evaluation = {"commanded": QUANTITY, "seeds": [{"seed": 0, "tasks": [task]}]}
    assert evaluate.draw_evaluate(tmp_path, evaluation, []) == []
    evaluation["seeds"][0]["tasks"].append({**task, "target": 1.0})
    assert [picture.name for picture in evaluate.draw_evaluate(tmp_path, evaluation, [])] == ["commanded_achieved.png"]


def test_a_search_shows_both_judgements_and_the_answer_of_the_map(tmp_path, drawn):
    epochs = [{"best_of_epoch": best, "reevaluated": again} for best, again in ((-9, -12), (-7, -8))]
    task = {"seed": 2, "name": "vel-3.6", "epochs": epochs, "zero_shot": {"reevaluated": -10}}
    (picture,) = adapt.draw_adapt(tmp_path, {"tasks": [task]})
    assert picture.name == "adaptation_seed2.png"
    assert drawn[:2] == [([1, 2], [-12, -8]), ([1, 2], [-9, -7])]
    np.testing.assert_array_equal(np.ravel(drawn[2]), [0, -10])
    assert adapt.draw_adapt(tmp_path, {"tasks": [{**task, "epochs": []}]}) == []
