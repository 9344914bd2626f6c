"""Figures of interpolation and of search: their lines show the documents' numbers."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import matplotlib
import numpy as np
import pytest
from matplotlib import pyplot
from matplotlib.axes import Axes
from mpl_toolkits.mplot3d import Axes3D

from ear_jax.figures import adapt, evaluate, interpolate
from ear_jax.figures import map as map_figure

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
    assert evaluate.draw_evaluate(tmp_path, evaluation, rows=[]) == []
    evaluation["seeds"][0]["tasks"].append({**task, "target": 1.0})
    drawn = evaluate.draw_evaluate(tmp_path, evaluation, "_x", rows=[])
    assert [picture.name for picture in drawn] == ["commanded_achieved_x.png"]


def test_every_episode_of_every_seed_is_a_point(tmp_path, monkeypatch, drawn):
    points, scatter = [], Axes.scatter
    monkeypatch.setattr(Axes, "scatter", lambda self, x, y, **how: points.append((x, y)) or scatter(self, x, y, **how))
    tasks = [{"target": float(target), "episodes": {"velocity": [target - 9.0, target + 9.0]}} for target in range(12)]
    seeds = [{"seed": seed, "tasks": tasks} for seed in (4, 5, 6)]
    rows = [
        {"seed": seed, "seconds": 60.0 * n, "mean_return": n, "env_steps": n, "updates": n}
        for n in (1, 2)
        for seed in (4, 5, 6)
    ]
    evaluate.draw_evaluate(tmp_path, {"commanded": QUANTITY, "seeds": seeds}, rows=rows)
    assert drawn[:3] == [([1.0, 2.0], [1, 2])] * 3
    assert [len(x) for x, _ in points] == [24] * 3
    (low, high), _ = drawn[3]
    assert low <= -9
    assert high >= 20, "the axes reach as far as the points"


def test_a_search_shows_both_judgements_and_the_answer_of_the_map(tmp_path, drawn):
    epochs = [{"best_of_epoch": best, "reevaluated": again} for best, again in ((-9, -12), (-7, -8))]
    task = {"seed": 2, "name": "vel-3.6", "epochs": epochs, "zero_shot": {"reevaluated": -10}}
    (picture,) = adapt.draw_adapt(tmp_path, {"tasks": [task]})
    assert picture.name == "adaptation_seed2.png"
    assert drawn[:2] == [([1, 2], [-12, -8]), ([1, 2], [-9, -7])]
    np.testing.assert_array_equal(np.ravel(drawn[2]), [0, -10])
    assert adapt.draw_adapt(tmp_path, {"tasks": [{**task, "epochs": []}]}) == []


def test_the_two_views_of_the_sphere_show_all_of_it_and_nothing_twice():
    one, other = (map_figure.direction_of(*view) for view in map_figure.VIEWS)
    np.testing.assert_allclose(one, -other, atol=1e-12)
    across = np.cross(one, [0, 0, 1])  # on the rim of both
    codes = np.concatenate([np.random.default_rng(0).normal(size=(1000, 3)), [across, -across, one, other]])
    shown = np.stack([map_figure.faces(codes, view) for view in (0, 1)])
    np.testing.assert_array_equal(shown.sum(0), 1)
    np.testing.assert_array_equal(shown[:, -2:], np.eye(2, dtype=bool))


def test_every_training_task_and_every_lte_is_drawn_once_on_the_sphere(tmp_path, monkeypatch):
    labels, points = [], []
    text, scatter = Axes3D.text, Axes3D.scatter
    monkeypatch.setattr(
        Axes3D, "text", lambda self, *where, **how: labels.append(where[3]) or text(self, *where, **how)
    )
    monkeypatch.setattr(
        Axes3D, "scatter", lambda self, *xyz, **how: points.append(np.size(xyz[0])) or scatter(self, *xyz, **how)
    )
    codes = np.random.default_rng(1).normal(size=(60, 3))
    codes = (codes / np.linalg.norm(codes, axis=1, keepdims=True)).tolist()
    trained = [{"name": f"vel-{index}", "target": float(index), "lte": code} for index, code in enumerate(codes[:12])]
    entry = {"seed": 3, "ltes": codes, "achieved": list(range(60)), "trained": trained}
    document = {"commanded": {**QUANTITY, "period": None}, "seeds": [entry]}
    pictures = map_figure.draw_map(tmp_path, document)
    assert [picture.name for picture in pictures] == ["sphere_seed3.png", "map_seed3.png"]
    assert sorted(labels, key=float) == [str(index) for index in range(12)]
    assert sum(points) == 60 + 12


def test_a_programs_own_matplotlib_stays_as_it_was(tmp_path):
    """Drawn in two threads at once, as a program may."""
    with matplotlib.rc_context({"backend": "svg", "font.size": 17}):
        documents = [{"pairs": [pair(seed, "1", "2", [1, 2, 3])]} for seed in range(8)]
        whole = [{**document, "betas": [1, 0.5, 0], "commanded": QUANTITY} for document in documents]
        with ThreadPoolExecutor(2) as threads:
            list(threads.map(interpolate.draw_interpolate, [tmp_path] * 8, whole))
        assert (matplotlib.rcParams["backend"], matplotlib.rcParams["font.size"]) == ("svg", 17)
    assert not pyplot.get_fignums()
