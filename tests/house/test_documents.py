"""Numbers in documents agree with records and tests; none that looks measured goes unchecked."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from benchmarks import common, recipe, scale
from ear_jax.runs import records
from experiments.report import documents, readme
from experiments.report.formatting import NAMES
from experiments.report.run_index import RunIndex
from tests.helpers import said, said_of_ltes
from tests.helpers.tolerances import MJX_TOLERANCES

ROOT = Path(__file__).parents[2]
DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
# A number that looks measured: with a unit of time, a share, a ratio, or negative as returns are.
MEASURED = re.compile(r"−\d[\d.,]*|\d[\d.,]* ?(?:s|seconds?|min|minutes?|hours?|ms|%|times)\b")
GIVEN = (  # chosen by us, by the models or by the paper
    "a step of 8 ms",
    "where a step is 8 ms",
    "some 20 times as large as joint angles",
    "take 8 times the room",
    "about 4 times what was measured",
    "paper's −136.9",
    "in [−1, 1]",
    "15° aside costs 3 %",  # 1 − cos 15°
    "15° aside costs 29 %",  # and sin 15°
)


def plain(path: Path) -> str:
    """Returns a document's prose in one line, without code and without parts written from records."""
    text = re.sub(r"<!-- (\w+) -->.*<!-- /\1 -->|```.*?```|`[^`]*`", "", path.read_text(), flags=re.DOTALL)
    return " ".join(text.split())


def test_readme_and_results_say_what_the_records_say():
    found = RunIndex("fast")
    assert documents.read(readme.README, readme.HEADLINE) == readme.headline(found)
    assert documents.read(readme.README, readme.RESULTS) == readme.results(found)
    assert documents.read(readme.DETAILS, readme.RESULTS) == readme.details(found)


@pytest.mark.parametrize(
    ("measured", "document"),
    [
        (said.of_the_cheetah, "docs/results.md"),
        (said.of_commands, "docs/results.md"),
        (said_of_ltes.of_rewards, "docs/asking-for-behaviour.md"),
        (said_of_ltes.of_courses, "docs/asking-for-behaviour.md"),
        (said.of_the_ant, "docs/fast.md"),
        (said.of_the_turned, "docs/fast.md"),
        (said.of_the_wide, "docs/fast.md"),
        (said_of_ltes.of_the_ring, "docs/trials.md"),
        (said_of_ltes.of_the_gathered, "docs/trials.md"),
        (said_of_ltes.of_run_jump_in_results, "docs/results.md"),
        (said_of_ltes.of_running_and_jumping, "docs/trials.md"),
        (said.of_the_long_run, "docs/trials.md"),
        (said.of_half_runs, "docs/trials.md"),
        (said.of_second_families, "docs/trials.md"),
        (said.of_refining, "docs/trials.md"),
        (said.of_refining, "docs/refining.md"),
        (said.of_refined_heads, "docs/refining.md"),
        (said.of_gains, "docs/fast.md"),
        (said.of_the_refined_ant, "docs/refining.md"),
        (said.of_the_penalty, "docs/refining.md"),
        (said.of_a_gpu, "docs/training.md"),
        (said.of_rounding, "docs/training.md"),
    ],
)
def test_documents_say_of_runs_and_commands_what_was_measured(measured, document):
    for words in measured():
        assert words in plain(ROOT / document)


def test_the_trials_of_the_recipe_are_those_of_its_rows():
    rows = records.read_rows(common.RESULTS / "recipe.jsonl")
    assert documents.read(recipe.DOCUMENT, recipe.PLACE) == recipe.trials(rows)


def test_what_scale_costs_is_what_its_rows_say():
    assert documents.read(scale.DOCUMENT, scale.PLACE) == scale.costs()


def test_the_error_of_mjx_is_said_to_be_what_its_test_allows():
    text = (ROOT / "docs" / "engines.md").read_text()
    for family, tolerances in MJX_TOLERANCES.items():
        cells = (", ".join(f"{value:g}" for value in numbers) for numbers in tolerances)
        assert f"| {NAMES[family]} | {' | '.join(cells)} |" in text


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.name)
def test_nothing_that_looks_measured_stands_unchecked(path):
    text = plain(path)
    for words in (
        *said.of_the_cheetah(),
        *said.of_the_long_run(),
        *said.of_commands(),
        *said_of_ltes.of_courses(),
        *said.of_half_runs(),
        *said.of_second_families(),
        *said.of_refining(),
        *said.of_refined_heads(),
        *said.of_a_gpu(),
        *said.of_rounding(),
        *GIVEN,
    ):
        text = text.replace(words, "")
    assert not MEASURED.findall(text)
