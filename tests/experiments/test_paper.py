"""The paper's numbers against its LaTeX, and the runs that its tables and figures need."""

from __future__ import annotations

import re
from collections import Counter
from typing import Any

import pytest

from ear_jax.cli import main as ear
from ear_jax.envs import FAMILIES, make_family
from ear_jax.methods import METHODS
from ear_jax.presets import preset_config
from experiments.inventory import jobs
from experiments.paper import EXPERIMENTS, FIGURES, TABLES, numbers
from experiments.report.settings import AGENTS

# Rows of the paper's LaTeX from the first & on, each with its place: a row of a panel, or part of a column.
OURS = (
    r"& \textbf{-136.9$\pm$1.29} & \textbf{1216.7$\pm$54.97} "
    r"& \textbf{173.5$\pm$11.09} & \textbf{172.7$\pm$4.05}\\"
)
ROWS = [
    ("table-1", "", 0, OURS),
    ("table-1", "", 1, r"& -500.9$\pm$47.33 & 422.8$\pm$29.40  & 34.0$\pm$41.92  & -4.9$\pm$0.58  \\"),
    ("table-1", "", 4, r"& -609.0$\pm$8.10 & 195.7$\pm$0.29 & 90.7$\pm$2.39 & 65.0$\pm$20.83   \\"),
    ("table-2", "", 10, r"& 1280 & 1280 & 1920 \\"),
    ("table-4", "seed 2", 3, r"& 0.30 & 2.69m/s \\"),
    ("table-5", "", 1, r"& 25/27 & 27/27 & 25/27 & 66/72 \\"),
    ("table-6", "vel-9 & vel-10", 2, r"& 1.2 & 8.76 \\"),
    ("table-6", "dir-0 & dir-15", 5, r"& -0.8 & 49.29 \\"),
    ("table-7", "dir-240, seed 5", 2, r"& 144 \\"),
    ("table-8", "", 0, r"& 16 in 72 tasks \\"),
    ("table-9", "", 1, r"&  \textbf{70/72}  & \textbf{66/72} \\"),
    ("table-10", "seed 3", 0, r"& 0.27 \\"),
]
COLUMNS = [
    ("table-12", "seed 3", "beta", 0, r"& 0.51 & 0.52 & 0.52 & 0.58 & 0.48 & 0.72 & 0.63 & 0.58 & 0.04 \\"),
    (
        "table-14",
        "seed 1",
        "outcome",
        16,
        r"& 247.50 & 262.48 & 277.50 & 292.61 & 307.56 & 322.49 & 337.55 & 352.42 \\",
    ),
    ("table-14", "seed 3", "target", 8, r"&  127.5 &  142.5&  157.5&  172.5&  187.5&  202.5&  217.5&  232.5 \\"),
    ("table-15", "seed 1", "outcome", 0, r"& 0.96 & 2.42 & 3.30 & 4.43 & 5.46 & 6.45 & 7.49 & 8.46 & 9.49  \\"),
    ("table-17", "seed 2", "outcome", 0, r"& 0.26 & 0.46 & 0.67 & 0.89 & 1.08 & 1.28 & 1.51 & 1.72 & 1.97 \\"),
    ("table-18", "seed 3", "outcome", 8, r"& 129.20 & 152.40 & 157.35 & 308.21 & 189.11 & 201.22 & 218.09 & 230.26 \\"),
]


def printed(line: str) -> list[float]:
    return [float(number) for number in re.findall(r"-?\d+(?:\.\d+)?", line)]


def numbers_in(row: list[Any]) -> list[float]:
    env_states = [list(cell.values()) if isinstance(cell, dict) else [cell] for cell in row]
    return [value for cell in env_states for value in cell if not isinstance(value, str)]


@pytest.mark.parametrize(("table", "panel", "row", "line"), ROWS)
def test_rows_are_as_printed(table, panel, row, line):
    expected = printed(line)
    assert numbers_in(numbers()[table]["panels"][panel][row])[-len(expected) :] == expected


@pytest.mark.parametrize(("table", "panel", "column", "first", "line"), COLUMNS)
def test_columns_are_as_printed(table, panel, column, first, line):
    data, expected = numbers()[table], printed(line)
    place = data["columns"].index(column)
    assert [row[place] for row in data["panels"][panel][first : first + len(expected)]] == expected


def test_every_table_and_figure_is_there_and_every_table_has_its_numbers():
    assert [table.id for table in TABLES] == [f"table-{number}" for number in range(1, 19)] == list(numbers())
    assert [figure.id for figure in FIGURES] == [f"figure-{number}" for number in range(2, 15)]
    for table in numbers().values():
        assert all(len(row) == len(table["columns"]) for rows in table["panels"].values() for row in rows)
    rows = [[len(rows) for rows in numbers()[f"table-{number}"]["panels"].values()] for number in range(11, 19)]
    assert rows == 2 * [[9] * 3, [9] * 3, [9] * 3, [24] * 3]


def test_the_paper_preset_has_the_papers_hyperparameters():
    """The learning rate is left out: it lost its exponent in print."""
    data = numbers()["table-2"]
    printed = {row[0]: dict(zip(data["columns"][1:], row[1:], strict=True)) for row in data["panels"][""]}
    for families in data["columns"][1:]:
        for family in families.split(" and "):
            config = preset_config(family, "paper")
            ours = {
                "LSE shape": config.network.lse_size,
                "LTE shape": config.network.lte_size,
                "discount": config.sac.discount,
                "batch size": config.sac.batch_size,
                "replay buffer": config.replay.capacity,
                "pretrain epochs": config.collect.pretrain_epochs,
                "training epochs": config.epochs,
                "optimization times": config.sac.updates,
                "evaluation episodes": config.log.episodes,
            }
            assert ours == {name: printed[name][families] for name in ours}


@pytest.mark.parametrize("preset", ["paper", "fast"])
def test_presets_have_as_many_tasks_as_the_papers_methods(preset):
    data = numbers()["table-3"]
    for name, *cells in data["panels"][""]:
        for families, cell in zip(data["columns"][1:], cells, strict=True):
            for family in families.split(" and "):
                config = preset_config(family, preset, AGENTS[name])
                count = config.task_count or len(make_family(family).training_tasks())
                assert f"{count} tasks" in cell, (name, family)


def test_runs_are_of_the_families_and_agents_that_the_paper_compares_and_of_ours():
    """All that ship appear in a table; a new one need not."""
    methods = {method for experiment in EXPERIMENTS.values() for method in experiment.methods}
    speeds = {"halfcheetah-vel", "hopper-vel", "walker-vel"}
    assert {method.family for method in methods} == {*speeds, "ant-dir", "halfcheetah-run-jump", "reach"}
    assert {method.family for method in methods} <= set(FAMILIES)
    agents = {"ear", "ear-rnn", "onehot", "onehot-blind", "multihead", "pearl", "maml"}
    assert {method.agent for method in methods} == agents <= set(METHODS)


def test_table_1_has_five_seeds_of_ear_and_three_of_the_others_on_every_family():
    wanted = jobs(EXPERIMENTS["table-1"], "fast")
    counts = Counter((job.config.family, job.config.agent, job.config.preset) for job in wanted)
    ant, speeds = "ant-dir", ("halfcheetah-vel", "hopper-vel", "walker-vel")
    ear = {**{(family, "ear", "fast"): 5 for family in speeds}, (ant, "ear", "fast+equivariant"): 5}
    others = ("pearl", "multihead", "onehot", "maml", "onehot-blind")
    turned = {(ant, "multihead", "fast+equivariant"): 3}
    assert counts == ear | turned | {(ant, "ear", "fast"): 3} | {
        (family, agent, "fast"): 3 for family in (ant, *speeds) for agent in others
    }


def test_every_analysis_is_a_command_line_that_ear_understands(tmp_path, monkeypatch, capsys):
    """Its only complaint is that there is no such run."""
    monkeypatch.chdir(tmp_path)
    methods = [method for experiment in EXPERIMENTS.values() for method in experiment.methods]
    of_families = {(method.family, analysis) for method in methods for analysis in method.analyses}
    analyses = {analysis for _, analysis in of_families}
    assert len(analyses) >= 12
    for analysis in analyses:
        written = [analysis.writes] if analysis.writes else []
        assert ear.main([analysis.command, "nowhere", *written, *analysis.options, "--json"]) == 2
        assert "nowhere is not a run directory" in capsys.readouterr().err, analysis.name
    names = [(family, analysis.name) for family, analysis in of_families]
    assert len(names) == len(set(names)), "a document's name tells its command"
