"""Names are text wherever they are shown: no markup of the terminal, no formula in a figure, no tag in a page."""

from __future__ import annotations

import html
import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest
import yaml
from markdown_it import MarkdownIt

from ear_jax.cli import results
from ear_jax.cli.adapt import _print as print_adapt
from ear_jax.cli.evaluate import print_evaluation
from ear_jax.cli.results import print_table
from ear_jax.figures.adapt import draw_adapt
from ear_jax.figures.compare import draw_compare
from ear_jax.figures.compose import draw_compose
from ear_jax.figures.evaluate import draw_evaluate
from ear_jax.figures.explore import Loop, write_page
from ear_jax.figures.interpolate import draw_interpolate
from ear_jax.figures.lse import draw_lse
from ear_jax.figures.map import draw_map
from ear_jax.figures.strip import Bounds, Panel, Track, draw_strip
from ear_jax.process.terminal import phase
from ear_jax.runs.model_card import to_markdown

NAMES = ("[/x]", "[red]a[/red]", ":smile:", "$x_{$", r"$\frac$", "</script><b>", "{0}%s", "\N{GREEK SMALL LETTER BETA}")


@pytest.mark.parametrize("name", NAMES)
def test_a_name_is_shown_as_it_is(name, capsys):
    task = {"name": name, "outcome": {name: 1.0}, "return_mean": -2.0, "failures": 1}
    quantity = {"outcome": name, "unit": name}
    seeds = [{"seed": 0, "tasks": [task]}]
    evaluation = {"run": name, "mean_return": 1.0, "commanded": quantity, "seeds": seeds, "episodes": 2}
    print_evaluation(evaluation)
    with phase(f"playing {name}"):
        print(name)
    epochs = [{"best_of_epoch": 1.0, "reevaluated": 1.0, "achieved": 1.0}]
    adapted = {"name": name, "seed": 0, "target": 1.0, "epochs": epochs, "zero_shot": None, "lte": [1.0]}
    print_adapt({"tasks": [adapted], "env_steps": 1, "map_env_steps": 1, "seconds": 1.0}, name)
    streams = capsys.readouterr()
    assert streams.out.count(name) >= 8
    assert streams.err.count(name) == 3


@pytest.mark.parametrize("name", NAMES)
def test_a_name_is_drawn_as_it_is(name, tmp_path):
    quantity = {"outcome": name, "unit": name}
    episodes = {name: [1.0, 2.0]}
    seeds = [{"seed": 0, "tasks": [{"name": name, "target": 1.0, "episodes": episodes}]}]
    pair = {"between": [name, name], "target": 1.5, "beta": 0.5, "outcome": 1.0, "curve": [1.0], "seed": 0}
    epochs = [{"best_of_epoch": 1.0, "reevaluated": 1.0, "achieved": 1.0}]
    adapted = {"name": name, "seed": 0, "target": 1.0, "epochs": epochs, "zero_shot": None, "lte": [1.0]}
    drawn = [
        *draw_evaluate(tmp_path, {"commanded": quantity, "seeds": seeds}, rows=[]),
        *draw_interpolate(tmp_path, {"pairs": [pair], "betas": [0.5], "commanded": quantity}),
        *draw_adapt(tmp_path, {"tasks": [adapted]}),
    ]
    assert all(picture.stat().st_size > 1000 for picture in drawn)


def test_names_are_drawn_as_they_are_in_all_other_figures(tmp_path):
    name, code = r"[b] $x_{$ \q", [0.6, 0.0, 0.8]
    quantity = {"outcome": name, "unit": name, "period": None}
    trained = [{"name": name, "target": None, "lte": code}]
    sphere = [{"seed": 0, "ltes": [code, code[::-1]], "achieved": [0.0, 1.0], "trained": trained}]
    blends = [{"beta": beta, "outcome": {name: beta}, "pattern": [[0], [1]]} for beta in (0.0, 1.0)]
    composed = {"between": [name, name], "dt": 0.1, "feet": [name], "seeds": [{"seed": 0, "blends": blends}]}
    signal = {"path": [[0, 1], [1, 0]], "explained": [0.5, 0.5], "autocorrelation": [1.0, 0.5], "period": None}
    gait = {"task": name, "dt": 0.1, "seeds": [{"seed": 0, "state": signal, "lse": signal}]}
    value = {"value": 1.0, "interval": [0.5, 1.5]}
    group = {"name": name, "mean": value, "interquartile_mean": value, "returns": [[1.0]]}
    compared = {"tasks": [name], "groups": [group, group], "probability_of_improvement": value}
    colours, limbs = np.zeros((1, 3)), np.array([[[[0.0, 0.0], [1.0, 1.0]]]])
    panel = Panel([Track(name, colours, limbs, np.array([0.1]), None)])
    drawn = [
        *draw_map(tmp_path, {"commanded": quantity, "seeds": sphere}),
        *draw_compose(tmp_path, {**composed, "commanded": quantity}, "_x"),
        *draw_lse(tmp_path, gait),
        *draw_compare([tmp_path / "compare.png"], compared),
        draw_strip(tmp_path / "strip.png", [panel], Bounds(0.0, 1.0, 0.0, 1.0, 0.0), name),
    ]
    assert len(drawn) == 6
    assert all(picture.stat().st_size > 1000 for picture in drawn)


def test_a_model_card_shows_a_name_as_it_is():
    """As Markdown is read: in a heading, in cells of tables, in code and in sentences."""
    name = " ".join((*NAMES, "a|b", "`c` ``d``", "*e* __f__ ~~g~~ &amp; \\"))
    task = {"name": name, "target": None, "return": 1.0}
    texts = dict.fromkeys(("name", "family", "command", "limits"), name)
    counts = dict.fromkeys(("side_by_side", "seed", "env_steps", "updates", "minutes", "mean_return", "episodes"), 1)
    others = {"agent": "ear", "preset": "fast", "engine": "native", "machine": {}, "versions": {}, "commit": "x"}
    text = to_markdown({**texts, **counts, **others, "tasks": [task], "returns_from": "x"}, "a b'.safetensors")
    front, body = text.removeprefix("---").split("\n---\n", 1)
    assert yaml.safe_load(front)["model-index"][0]["name"] == name
    assert html.unescape(MarkdownIt("commonmark").enable(["table", "strikethrough"]).render(body)).count(name) == 7
    assert shlex.split(re.search("^ear evaluate (.*)$", body, re.MULTILINE)[1]) == [
        "a b'.safetensors",
        "--family",
        name,
    ]


def test_a_name_ends_no_script_of_the_page(tmp_path):
    loop = Loop(np.zeros((2, 1, 2, 2)), np.zeros((3, 2)), False)
    commanded = {"outcome": NAMES[5], "unit": NAMES[5], "period": None}
    document = {"title": NAMES[5], "commanded": commanded, "achieved": [0.0, 1.0], "trained": [{"name": NAMES[5]}]}
    page = write_page(tmp_path / "page.html", document, [loop, loop]).read_text()
    assert NAMES[5] not in page
    assert json.loads(re.search(r"\{\"title\".*\}", page)[0])["title"] == NAMES[5]


def test_commands_print_tables_by_one_helper():
    files = {path.name for path in Path(results.__file__).parent.glob("*.py") if "rich.table" in path.read_text()}
    assert not files


def test_a_table_breaks_no_name_and_cuts_no_column(capsys):
    rows = [("halfcheetah-run-jump", "1"), ("日本", "22")]
    print_table(("family", "tasks>"), rows, "title")
    title, heading, rule, *lines = capsys.readouterr().out.splitlines()
    assert (title, heading, set(rule)) == ("title", "family                 tasks", {"─"})
    assert lines == ["halfcheetah-run-jump       1", "日本                      22"]
