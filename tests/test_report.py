"""The report: what it says of made-up records is worked out by hand; of the real ones, that it is whole and true."""

from __future__ import annotations

import dataclasses
import html.parser
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from ear_jax import interpolate, records
from ear_jax.config import preset_config
from ear_jax.envs.family import Family
from experiments import inventory
from experiments.__main__ import main
from experiments.paper import COMPOSED, EXPERIMENTS, SPEEDS_BEYOND
from experiments.report import comparison, markdown, readme, sections, settings, tables
from experiments.report.blocks import Section, Table
from experiments.report.command import write
from experiments.report.found import Found

ROOT = Path(__file__).parents[1]
MADE = {"machine": {"processor": "Z80", "cores": 1}, "versions": {}, "commit": "c0ffee"}
SPEEDS = [float(speed) for speed in range(1, 11)]


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """No records, to begin with."""
    monkeypatch.setattr(inventory, "RECORDS", tmp_path / "records")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def record(
    family: str = "halfcheetah-vel",
    agent: str = "ear",
    preset: str = "fast",
    seed: int = 0,
    level: float = -200,
    **made: Any,
) -> Path:
    """A record of two rows, whose tasks return `level` and a little more each."""
    config = dataclasses.replace(preset_config(family, preset, agent), seed=seed, **made)
    directory = inventory.RECORDS / f"{family}-{agent}-{preset}-seed{seed}"
    directory.mkdir(parents=True)
    tasks = [{"name": f"vel-{speed:g}", "target": speed, "params": {}} for speed in SPEEDS]
    records.write_json(directory / "config.json", {"config": dataclasses.asdict(config), "tasks": tasks, **MADE})
    returns = {task["name"]: level + index for index, task in enumerate(tasks)}
    for epoch in (10, config.epochs):
        row = {"seed": seed, "epoch": epoch, "env_steps": 2000 * epoch, "updates": 200 * epoch, "seconds": 6.0 * epoch}
        records.append_rows(directory / "metrics.jsonl", [{**row, "mean_return": level + 4.5, "returns": returns}])
    return directory


def add(directory: Path, name: str, **document: Any) -> None:
    records.write_json(directory / f"{name}.json", {**document, **MADE, "command": f"ear {name}"})


def add_pairs(directory: Path, seed: int, successes: int) -> None:
    """Nine pairs, of which so many meet the value midway and one fewer lies between at β = ½."""
    pairs = [
        {
            "seed": seed,
            "between": [f"vel-{one:g}", f"vel-{one + 1:g}"],
            "target": one + 0.5,
            "beta": 0.4,
            "outcome": one + 0.51,
            "mid_task": index < successes,
            "one_to_one": index < successes - 1,
            "one_to_one_outcome": one + 0.6 + 0.1 * seed,
        }
        for index, one in enumerate(SPEEDS[:-1])
    ]
    add(directory, "interpolation", pairs=pairs)


def section(id: str, out: Path, preset: str = "fast") -> str:
    """One section as Markdown."""
    found = Found(preset)
    whole = {"comparison": comparison.comparison, "runs": sections.all_runs}
    one = whole[id](found) if id in whole else sections.section(EXPERIMENTS[id], found, out)
    return markdown.document("", [], [one])


def cells(text: str, row: str) -> list[str]:
    """The cells of the first table row that begins with a word."""
    line = next(line for line in text.splitlines() if line.startswith(f"| {row} |"))
    return [cell.strip() for cell in line.strip("|").split("|")]


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


def test_the_committed_records_are_reported_without_jax(tmp_path):
    code = (
        "import sys; from experiments.__main__ import main\n"
        "assert main(['report', '--out', sys.argv[1]]) == 0\nprint('jax' in sys.modules)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, tmp_path / "new" / "page"], capture_output=True, text=True, cwd=ROOT
    )
    assert done.returncode == 0, done.stderr
    *paths, jax = done.stdout.split()
    assert paths == [str(tmp_path / "new" / "page" / name) for name in ("index.html", "tables.md")]
    assert jax == "False"
    page = check_page(tmp_path / "new" / "page")
    assert page.images


def test_readme_says_what_the_records_say():
    text = readme.README.read_text()
    assert text.partition(readme.BEGIN)[2].partition(readme.END)[0] == "\n" + readme.results(Found("fast"))


def test_readme_is_rewritten_between_its_markers_alone(place, monkeypatch, capsys):
    record()
    monkeypatch.setattr(readme, "README", place / "README.md")
    readme.README.write_text(f"before\n{readme.BEGIN}\nold\n{readme.END}\nafter\n")
    assert main(["report", "--readme"]) == 0
    text = readme.README.read_text()
    assert (text.startswith("before\n"), text.endswith("\nafter\n"), "old" in text) == (True, True, False)
    assert "−195.5 (1 seed; 40.0 min, 800,000 env steps, 80,000 updates)" in text
    assert main(["report", "--readme"]) == 0
    assert readme.README.read_text() == text
    readme.README.write_text("nothing")
    assert main(["report", "--readme"]) == 1
    assert "has no place for the results" in capsys.readouterr().err


def test_a_record_that_is_gone_shows_as_missing_and_breaks_nothing(place):
    shutil.copytree(ROOT / "experiments" / "records", inventory.RECORDS)
    gone = sorted(inventory.RECORDS.glob("hopper-vel-ear-fast-seed*"))
    assert cells(section("table-5", place / "out"), "Hopper-Vel")[3] != "—, no run yet"
    for directory in gone:
        shutil.rmtree(directory)
    assert cells(section("table-5", place / "out"), "Hopper-Vel")[3] == "—, no run yet"
    assert "no run yet" in section("table-12", place / "out")
    write(Found("fast"), place / "out")
    check_page(place / "out")


def test_without_any_record_everything_is_missing(place):
    write(Found("fast"), place / "out")
    page = check_page(place / "out")
    assert page.images == []
    text = (place / "out" / "tables.md").read_text()
    for experiment in EXPERIMENTS.values():
        part = next(
            part for part in text.split("\n## ") if part.startswith(experiment.id.replace("-", " ").capitalize())
        )
        assert "no run yet" in part or not experiment.methods, experiment.id


def test_returns_are_the_mean_over_seeds_with_interval_and_chance_of_being_better(place):
    for seed, level in enumerate((-200, -210, -190)):
        record(seed=seed, level=level)
        record(agent="multihead", seed=seed, level=level - 100)
    text = section("table-1", place / "out")
    ours, baseline = cells(text, "EAR-SAC"), cells(text, "MHMT-SAC")
    assert ours[1:3] == ["−136.9 ± 1.29", "−195.5 ± 10.0"]
    middle, low, high = (float(number) for number in re.findall(r"-\d+\.\d", ours[3].replace("−", "-")))
    assert low < middle == -195.5 < high
    assert ours[4:] == ["—", "3 seeds", "800,000", "80,000", "40.0"]
    assert baseline[4] == "1.00 [1.00, 1.00]"
    assert cells(text, "PEARL")[2] == "—, no run yet"
    assert text.count("`ear train halfcheetah-vel --agent multihead --preset fast --seed 2`") == 1


def test_one_seed_has_no_spread(place):
    record()
    assert cells(section("table-1", place / "out"), "EAR-SAC")[2:6] == ["−195.5", "—", "—", "1 seed"]


def test_an_evaluation_counts_before_the_last_row_of_training(place):
    directory = record()
    tasks = [
        {
            "name": f"vel-{speed:g}",
            "target": speed,
            "return_mean": -100.0 - speed,
            "failures": 0,
            "outcome": {"velocity": speed - 0.1, "squared_action": 1.0},
            "episodes": {"length": [200, 200]},
        }
        for speed in SPEEDS
    ]
    add(directory, "evaluation", seeds=[{"seed": 0, "tasks": tasks}])
    assert cells(section("table-1", place / "out"), "EAR-SAC")[2] == "−105.5"
    said = section("comparison", place / "out")
    assert "about −66 of our return" in said, "of −105.5 at 0.1 + 0.1 a step 200 steps explain −40"
    assert "vel-10 and vel-9, make −21.9" in said
    assert "- HalfCheetah-Vel, return: −105.5 (1 seed); the paper −136.9 ± 1.29." in said.partition("Short of")[0]


def test_interpolation_of_all_seeds_is_counted_together(place):
    for seed, successes in enumerate((9, 8)):
        add_pairs(record(seed=seed), seed, successes)
    text = section("table-5", place / "out")
    assert cells(text, "HalfCheetah-Vel")[1:] == ["mid-task", "26 of 27", "17 of 18 (2 seeds)"]
    assert cells(text, "HalfCheetah-Vel | 1:1")[2:] == ["25 of 27", "15 of 18 (2 seeds)"]
    midway = section("table-11", place / "out")
    assert cells(midway, "1.5") == ["1.5", "0.47 → 1.60", "0.42 → 1.51", "0.37 → 1.49", "0.40 → 1.51", "0.40 → 1.51"]
    assert "ours 0.010 [0.010, 0.010] m/s (2 seeds)" in midway
    assert cells(section("table-15", place / "out"), "2.5")[4:] == ["2.60", "2.70", "2.65 ± 0.07"]
    said = section("comparison", place / "out")
    assert "β = ½ gives a value between: 15 of 18 pairs (2 seeds); the paper 25 of 27." in said.partition("Short of")[2]


def test_directions_are_compared_the_short_way_round(place):
    directory = record("ant-dir")
    pair = {
        "seed": 0,
        "between": ["dir-345", "dir-0"],
        "target": 352.5,
        "beta": 0.5,
        "mid_task": True,
        "one_to_one": True,
    }
    targets = [7.5 + 15 * index for index in range(24)]
    pairs = [{**pair, "target": one, "outcome": one, "one_to_one_outcome": (one + 9) % 360} for one in targets]
    add(directory, "interpolation", pairs=pairs)
    text = section("table-18", place / "out")
    assert cells(text, "352.5")[-1] == "1.50"
    assert "ours 9.000 ° (1 seed)" in text


def test_failures_without_noise(place):
    for ablation, lengths in (("", [200, 200]), ("+no-noise", [200, 150])):
        directory = record("ant-dir", preset=f"fast{ablation}")
        tasks = [
            {
                "name": f"dir-{name}",
                "target": name,
                "return_mean": 1.0,
                "failures": failures,
                "episodes": {"length": length},
            }
            for name, failures, length in ((0, int(lengths[1] < 200), lengths), (15, 0, [200, 200]))
        ]
        add(directory, "evaluation", seeds=[{"seed": 0, "tasks": tasks}])
    text = section("table-8", place / "out")
    assert cells(text, "without noise")[1:] == ["16 of 72", "1 of 2 (1 seed)"]
    assert cells(text, "with noise")[1:] == ["0 of 72", "0 of 2 (1 seed)"]
    assert cells(section("table-7", place / "out"), "ours, seed 0, dir-0")[1:] == ["200", "150", "—", "—", "—"]


def test_extrapolation_composition_and_all_pictures(place):
    directory = record()
    blends = [{"seed": 0, "between": ["vel-1", "vel-2"], "beta": beta, "outcome": 3 - beta} for beta in (1.8, -0.8)]
    add(directory, SPEEDS_BEYOND[0].name, blends=blends)
    epochs = [{"best_of_epoch": -90.0, "reevaluated": -95.0 - epoch, "achieved": 3.5} for epoch in range(10)]
    answer = {"achieved": 3.4, "error": 0.1, "reevaluated": -99.0}
    found = {"seed": 0, "name": "vel-3.5", "target": 3.5, "epochs": epochs, "zero_shot": answer}
    add(directory, "adaptation", tasks=[found])
    code = {"ltes": [[1, 0, 0], [0, 1, 0], [0, 0, -1], [-1, 0, 0]], "achieved": [1, 2, 3, 4]}
    trained = [{"name": "vel-1", "target": 1.0, "lte": [0, 0, 1]}]
    commanded = {"outcome": "velocity", "unit": "m/s", "period": None}
    add(directory, "map", commanded=commanded, seeds=[{"seed": 0, **code, "trained": trained}])
    signal = {"explained": [0.6, 0.2], "period": 0.2, "autocorrelation_peak": 0.9, "path": [[0, 1], [1, 0]]}
    signal["autocorrelation"] = [1.0, 0.5]
    add(directory, "lse", task="vel-5", dt=0.05, seeds=[{"seed": 0, "state": signal, "lse": signal}])
    add(directory, "stills", scenes=[{"name": "β = 0.5", "outcome": 1.5, "steps": 100}])
    outcome = {"velocity": -1.0, "height": 0.3, "squared_action": 1.0}
    blend = {"beta": 0.5, "outcome": outcome, "contact": {"hind": 0.5}, "airborne": 0.25, "pattern": [[1], [0]]}
    composed = {"between": ["back-1", "jump-1"], "steps": 1000, "dt": 0.05, "commanded": commanded, "feet": ["hind"]}
    add(record("halfcheetah-run-jump"), COMPOSED[0].name, **composed, seeds=[{"seed": 0, "blends": [blend]}])
    assert cells(section("table-6", place / "out"), "-0.8".replace("-", "−"))[1:] == ["2.35", "3.80"]
    assert cells(section("table-10", place / "out"), "0.5") == ["0.5", "−1.00", "0.30", "50 %", "25 %"]
    assert "| β = 0.5 | 1.50 | 100 | seed 0 |" in section("figure-3", place / "out")
    assert cells(section("figure-5", place / "out"), "HalfCheetah-Vel, EAR-SAC, seed 0")[1:5] == [
        "3.50",
        "3.40",
        "0.10",
        "−99.0",
    ]
    write(Found("fast"), place / "out")
    shown = {str(image["src"]) for image in check_page(place / "out").images}
    assert shown == {
        *(f"figures/{name}.png" for name in ("figure-2", "figure-5", "figure-8", "figure-9-seed0")),
        *(
            f"figures/{name}.png"
            for name in ("sphere_seed0", "map_seed0", "lse_seed0", "compose_back-1_to_jump-1_seed0")
        ),
    }


def test_a_run_with_other_tasks_or_another_reward_is_no_run_of_the_preset(place):
    record(tasks=("1", "2"))
    record("ant-dir", env=dataclasses.replace(preset_config("ant-dir", "fast").env, lateral_weight=1.0))
    assert Found("fast").all() == []


def test_a_run_of_an_earlier_recipe_is_shown_with_what_was_otherwise(place):
    config = preset_config("halfcheetah-vel", "fast")
    record(sac=dataclasses.replace(config.sac, lr=3e-4), minutes=15.0, epochs=900)
    text = section("runs", place / "out")
    row = cells(text, "halfcheetah-vel-ear-fast-seed0")
    assert row[1:3] == ["seed 0", "900 of 900"]
    assert row[-1] == "sac.lr 0.0003"
    assert "--seed 0 --minutes 15`" in section("table-11", place / "out")


def test_seeds_trained_together_are_told_apart(place):
    directory = record(seeds=2)
    rows = records.read_rows(directory / "metrics.jsonl")
    records.append_rows(directory / "metrics.jsonl", [{**row, "seed": 1} for row in rows])
    assert [run.seed for run in Found("fast").runs("halfcheetah-vel")] == [0, 1]
    assert cells(section("table-1", place / "out"), "EAR-SAC")[5] == "2 seeds"
    assert "--seed 0 --seeds 2`" in section("table-1", place / "out")


def test_another_preset_has_its_own_runs(place):
    record(preset="paper")
    assert cells(section("table-1", place / "out"), "EAR-SAC")[2] == "—, no run yet"
    assert cells(section("table-1", place / "out", "paper"), "EAR-SAC")[2] == "−195.5"


def test_text_is_escaped(place):
    directory = record()
    document = json.loads((directory / "config.json").read_text())
    document["machine"]["processor"] = "<script>alert(1)</script> | `x` & y"
    records.write_json(directory / "config.json", document)
    write(Found("fast"), place / "out")
    check_page(place / "out")
    assert "&lt;script&gt;" in (place / "out" / "index.html").read_text()
    assert len(cells(section("runs", place / "out").replace("\\|", "/"), directory.name)) == 9


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        ("--preset fats", "did you mean 'fast'"),
        ("--out file", "--out file is no directory"),
        ("--out file/below", "--out file/below is no directory"),
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


def test_what_is_said_of_the_code_is_so():
    """Constants that the report repeats, as it reads no module that imports JAX."""
    assert Family.episode_length == settings.EPISODE
    table = tables.interpolation_counts(Found("fast"))[0]
    assert isinstance(table, Table)
    low, high = interpolate.MID_TASK_RANGE
    assert f"between {low:g} and {high:g} meets the value midway, to {100 * interpolate.REACHED:g} %" in table.caption
    assert f"we take {100 * interpolate.REACHED:g} % of the distance" in " ".join(comparison.WHY)
    assert isinstance(comparison.comparison(Found("fast")), Section)
