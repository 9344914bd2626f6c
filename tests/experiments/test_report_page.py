"""The report as a page and in README: of the committed records, of a few, of none, and of bad ones."""

from __future__ import annotations

import html.parser
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from ear_jax.runs import records
from experiments import inventory
from experiments.__main__ import main
from experiments.paper import COMPOSED, EXPERIMENTS, SPEEDS_BEYOND
from experiments.report import readme
from experiments.report.command import write
from experiments.report.run_index import RunIndex
from tests.helpers.fake_records import add, add_pairs, cells, record, section

ROOT = Path(__file__).parents[2]


class Tags(html.parser.HTMLParser):
    """Checks that tags close in their order, and keeps ids, links and images."""

    def __init__(self, page: str):
        super().__init__()
        self.open: list[str] = []
        self.ids: list[str] = []
        self.links: list[str] = []
        self.images: list[dict[str, str | None]] = []
        self.names: set[str] = set()
        self.feed(page)
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = dict(attrs)
        self.names.add(tag)
        if tag not in ("meta", "img"):
            self.open.append(tag)
        self.ids += [str(found["id"])] if "id" in found else []
        self.links += [str(found["href"])] if tag == "a" else []
        self.images += [found] if tag == "img" else []

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def check_page(out: Path) -> Tags:
    text = (out / "index.html").read_text()
    page = Tags(text)
    assert set(EXPERIMENTS) < set(page.ids)
    assert len(page.ids) == len(set(page.ids))
    assert set(page.links) == {f"#{id}" for id in page.ids}
    assert all(image["alt"] and (out / str(image["src"])).is_file() for image in page.images)
    assert not {"script", "link", "iframe"} & page.names
    assert not re.search(r"https?://|url\(|@import", text)
    return page


def test_the_committed_records_are_reported(tmp_path):
    code = "import sys; from experiments.__main__ import main\nassert main(['report', '--out', sys.argv[1]]) == 0"
    done = subprocess.run(
        [sys.executable, "-c", code, tmp_path / "new" / "page"], capture_output=True, text=True, cwd=ROOT
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == [str(tmp_path / "new" / "page" / name) for name in ("index.html", "tables.md")]
    page = check_page(tmp_path / "new" / "page")
    assert page.images


def test_documents_are_rewritten_between_their_markers_alone(place, monkeypatch, capsys):
    record()
    record(agent="onehot")
    record(agent="onehot-blind", level=-600)
    documents = {name: place / f"{name}.md" for name in ("README", "DETAILS")}
    for name, path in documents.items():
        monkeypatch.setattr(readme, name, path)
        headline = "<!-- headline -->\nold\n<!-- /headline -->\n" if name == "README" else ""
        path.write_text(f"before\n{headline}<!-- results -->\nold\n<!-- /results -->\nafter\n")
    assert main(["report", "--docs"]) == 0
    assert capsys.readouterr().out.split() == [str(path) for path in documents.values()]
    texts = [path.read_text() for path in documents.values()]
    for text in texts:
        assert (text.startswith("before\n"), text.endswith("\nafter\n"), "\nold\n" in text) == (True, True, False)
    assert texts[0].startswith("before\n<!-- headline -->\n\nHalfCheetah-Vel has no analysed run yet.\n")
    assert "| HalfCheetah-Vel | −195.5 | — | −136.9 ± 1.29 | — | — (26/27) | — (25/27) | 1 | 40 |" in texts[0]
    assert (
        "| HalfCheetah-Vel | −195.5 (1 seed) | −136.9 ± 1.29 | — | — (26 of 27) | — (25 of 27) | — | 40 |" in texts[1]
    )
    assert "HalfCheetah-Vel 800,000 (10 %) and 80,000 (10 %)." in texts[1]
    assert "| HalfCheetah-Vel | −195.5 (1 seed) | −595.5 (1 seed) | −609.0 ± 8.10 |" in texts[1]
    assert "| Ant-Dir | — | — | 195.7 ± 0.29 |" in texts[1]
    assert "## Table 18: 1:1 interpolation, Ant-Dir" in texts[1]
    assert main(["report", "--docs"]) == 0
    assert [path.read_text() for path in documents.values()] == texts
    documents["README"].write_text("nothing")
    assert main(["report", "--docs"]) == 1
    assert "lacks the markers <!-- headline --> and <!-- /headline -->" in capsys.readouterr().err


def test_readmes_first_number_is_that_of_the_records(place):
    for seed, (level, successes) in enumerate(((-200, 9), (-180, 8))):
        add_pairs(record(seed=seed, level=level), seed, successes)
    said = readme.headline(RunIndex("fast"))
    assert (
        "for 15 of 18 pairs of neighbouring trained speeds, a blend runs at the speed midway**, to within 0.05 m/s in "
        "the mean of 10 fresh episodes; over all pairs the mean error is 0.02 m/s. On the 3 episodes by which "
        "the blend was chosen: 17 of 18 (the paper: 26 of 27)" in said
    )
    assert "returns −185.5 ± 14.1 (2 seeds), short of the paper's −136.9 ± 1.29, after 10 % of the paper's env" in said
    assert said.endswith(" env steps: 40 minutes a seed on one CPU core.")


def test_a_record_that_is_gone_shows_as_missing_and_breaks_nothing(place):
    for directory in (ROOT / "experiments" / "records").glob("h*-vel-ear-fast-seed[01]"):
        shutil.copytree(directory, inventory.RECORDS / directory.name)
    gone = sorted(inventory.RECORDS.glob("hopper-vel-ear-fast-seed*"))
    assert cells(section("table-5", place / "out"), "Hopper-Vel")[5] != "—, no run yet"
    for directory in gone:
        shutil.rmtree(directory)
    assert cells(section("table-5", place / "out"), "Hopper-Vel")[5] == "—, no run yet"
    assert "no run yet" in section("table-12", place / "out")
    write(RunIndex("fast"), place / "out")
    check_page(place / "out")


def test_without_any_record_everything_is_missing(place):
    write(RunIndex("fast"), place / "out")
    page = check_page(place / "out")
    assert page.images == []
    text = (place / "out" / "tables.md").read_text()
    for experiment in EXPERIMENTS.values():
        part = next(
            part for part in text.split("\n## ") if part.startswith(experiment.id.replace("-", " ").capitalize())
        )
        assert "no run yet" in part or not experiment.methods, experiment.id


def test_extrapolation_composition_and_all_pictures(place):
    directory = record()
    blends = [{"seed": 0, "between": ["vel-1", "vel-2"], "beta": beta, "outcome": 3 - beta} for beta in (1.8, -0.8)]
    add(directory, SPEEDS_BEYOND[0].name, blends=blends)
    epochs = [{"best_of_epoch": -90.0, "reevaluated": -95.0 - epoch, "achieved": 3.5} for epoch in range(10)]
    answer = {"achieved": 3.4, "error": 0.1, "reevaluated": -99.0}
    found = {"seed": 0, "name": "vel-3.5", "target": 3.5, "epochs": epochs, "zero_shot": answer}
    add(directory, "adaptation", tasks=[found], env_steps=180_000, map_env_steps=100_000)
    code = {"ltes": [[1, 0, 0], [0, 1, 0], [0, 0, -1], [-1, 0, 0]], "achieved": [1, 2, 3, 4]}
    trained = [{"name": "vel-1", "target": 1.0, "lte": [0, 0, 1]}]
    commanded = {"outcome": "velocity", "unit": "m/s", "period": None}
    add(directory, "map", commanded=commanded, seeds=[{"seed": 0, **code, "trained": trained}])
    space = {"space": 0.8, "smooth": 0.5, "lasting": 1.0, "covered": 0.91, "ordered": 0.97, "lipschitz": 12.5}
    add(directory, "space", seeds=[{"seed": 0, "space": {**space, "steep": 5.7}}])
    signal = {"explained": [0.6, 0.2], "period": 0.2, "autocorrelation_peak": 0.9, "path": [[0, 1], [1, 0]]}
    signal["autocorrelation"] = [1.0, 0.5]
    add(directory, "lse", task="vel-5", dt=0.05, seeds=[{"seed": 0, "state": signal, "lse": signal}])
    scenes = [{"name": "β = 0.5", "outcome": 1.5, "steps": 100}]
    add(directory, "stills", commanded=commanded, scenes=scenes, seeds=[])
    (directory / "stills.png").write_bytes(b"a strip")
    outcome = {"velocity": -1.0, "height": 0.3, "squared_action": 1.0}
    blend = {"beta": 0.5, "outcome": outcome, "contact": {"hind": 0.5}, "airborne": 0.25, "pattern": [[1], [0]]}
    composed = {"between": ["back-1", "jump-1"], "steps": 1000, "dt": 0.05, "commanded": commanded, "feet": ["hind"]}
    add(record("halfcheetah-run-jump"), COMPOSED[0].name, **composed, seeds=[{"seed": 0, "blends": [blend]}])
    assert cells(section("table-6", place / "out"), "-0.8".replace("-", "−"))[1:] == ["2.35", "3.80"]
    measured = cells(section("space", place / "out"), "HalfCheetah-Vel")[1:]
    assert measured == ["1", "0.80", "0.50", "1.00", "0.91", "0.97", "12.5"]
    assert cells(section("table-10", place / "out"), "0.5") == ["0.5", "−1.00", "0.30", "50 %", "25 %"]
    assert "100 steps from one start: β = 0.5 1.50 m/s, seed 0." in section("figure-3", place / "out")
    assert cells(section("figure-5", place / "out"), "HalfCheetah-Vel, EAR-SAC, seed 0")[1:5] == [
        "3.50",
        "3.40",
        "0.10",
        "−99.0",
    ]
    write(RunIndex("fast"), place / "out")
    shown = {str(image["src"]) for image in check_page(place / "out").images}
    assert shown == {
        *(f"figures/{name}.png" for name in ("returns", "figure-2", "figure-5", "figure-8", "figure-9-seed0")),
        *(
            f"figures/{name}.png"
            for name in ("sphere_seed0", "map_seed0", "lse_seed0", "compose_back-1_to_jump-1_seed0")
        ),
        f"figures/{directory.name}-stills.png",
    }


def test_text_is_escaped(place):
    directory = record()
    document = json.loads((directory / "config.json").read_text())
    document["machine"]["processor"] = "<script>alert(1)</script> | `x` & y"
    records.write_json(directory / "config.json", document)
    write(RunIndex("fast"), place / "out")
    check_page(place / "out")
    assert "&lt;script&gt;" in (place / "out" / "index.html").read_text()
    assert len(cells(section("runs", place / "out").replace("\\|", "/"), directory.name)) == 9


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        ("--preset fats", "did you mean 'fast'"),
        ("--out file", "--out file cannot be a directory"),
        ("--out file/below", "--out file/below cannot be a directory"),
        ("--outt x", "did you mean --out? (`python -m experiments report --help`"),
    ],
)
def test_a_mistake_gets_one_line(words, complaint, place, capsys):
    (place / "file").touch()
    assert main(["report", *words.split()]) == 2
    error = capsys.readouterr().err
    assert complaint in error
    assert (error[:13], error.count("\n")) == ("experiments: ", 1)


@pytest.mark.parametrize("name", ["config.json", "interpolation.json"])
def test_a_torn_record_is_named(name, place, capsys):
    directory = record()
    (directory / name).write_text("{")
    assert main(["report"]) == 1
    error = capsys.readouterr().err
    assert f"{directory / name} cannot be read" in error
    assert error.count("\n") == 1
