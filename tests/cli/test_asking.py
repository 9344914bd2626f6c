"""Asking for behaviour from the command line: rewards, the imagined sphere and courses."""

from __future__ import annotations

import json
import statistics

import pytest

from ear_jax.cli.adapt import _better as better
from ear_jax.cli.main import main
from ear_jax.embeddings import imagine, survey
from tests.helpers.documented import check_keys

SMALL = ["--epochs", "1", "--elites", "2", "--samples", "1", "--episodes", "1"]


@pytest.fixture
def few(monkeypatch) -> None:
    """A survey and an imagined sphere of few places."""
    monkeypatch.setattr(survey, "PLACES", 12)
    monkeypatch.setattr(imagine, "PLACES", 12)


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (
            ["adapt", "RUN", "--reward", "velocty"],
            "column 1 of reward 'velocty': unknown outcome 'velocty'; did you mean",
        ),
        (["adapt", "RUN", "--reward", "-abs(velocity"], "column 5 of reward '-abs(velocity'"),
        (["adapt", "RUN", "--reward", "1", "--target", "2"], "give either --target X or --reward EXPR"),
        (["adapt", "RUN", "--reward", "1", "2", "--save", "x"], "--save x saves the LTE of one task"),
        (["adapt", "RUN", "--reward", "velocity", "velocity"], "is given twice"),
        (["imagine", "RUN", "--discount", "1"], "--discount 1 is out of range; it must be from 0 to below 1"),
        (["imagine", "RUN", "--cells", "1"], "--cells 1 is too small"),
        (["front", "RUN", "--reward", "velocity"], 'name two rewards, as in --reward "-velocity" height, not 1'),
        (["front", "RUN", "--reward", "-velocity", "hight"], "unknown outcome 'hight'"),
        (["follow", "RUN"], "give one of --profile SECONDS:VALUE,... and --path X Y,..."),
        (["follow", "RUN", "--profile", "0:1, 3"], "'3' is not seconds:value"),
        (["follow", "RUN", "--path", "1 0"], "does not move freely on the floor; give --profile"),
        (["follow", "RUN", "--profile", "0:1, 3:2", "--sigma", "0"], "--sigma 0 is too small"),
    ],
)
def test_a_mistake_is_one_line(finished_once, words, complaint, capsys):
    assert main([str(finished_once) if word == "RUN" else word for word in words]) == 2
    message = capsys.readouterr().err
    assert complaint in message
    assert message.count("\n") == 1


def test_a_reward_is_answered_saved_and_used(finished, few, capsys):
    words = ["adapt", str(finished), "--reward", "-abs(velocity-1)", "--zero-shot", "--episodes", "1", "--save", "slow"]
    assert main([*words, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert [task["name"] for task in document["tasks"]] == ["-abs(velocity-1)"] * 2
    assert document["costs"]["map"]["env_steps"] == 2 * 12 * 200
    assert all(task["answers"]["map"]["lte"] == task["lte"] for task in document["tasks"])
    saved = json.loads((finished / "ltes.json").read_text())["slow"]
    assert (saved["task"], saved["asked_by"]) == ("-abs(velocity-1)", "--reward")
    assert main(["interpolate", str(finished), "--between", "1", "slow"]) == 2
    assert "'slow' has no target velocity to meet between" in capsys.readouterr().err


def test_a_trade_off_is_drawn(finished, few, capsys):
    words = ["front", str(finished), "--reward", "-velocity", "-squared_action", "--json"]
    assert main(words) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["rewards"] == ["-velocity", "-squared_action"]
    assert [len(seed["rewards"]) for seed in document["seeds"]] == [12, 12]
    assert [len(seed["trained"]) for seed in document["seeds"]] == [2, 2]
    assert main(words[:-1]) == 0
    text = capsys.readouterr().out
    assert "LTEs on the front, of 12 played" in text
    assert len(list((finished / "figures").glob("front_*_seed*.png"))) == 2


@pytest.mark.slow
def test_what_a_run_replayed_is_imagined(finished, few, capsys):
    assert main(["imagine", str(finished), "--updates", "20", "--cells", "8", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    check_keys("imagination", {key: value for key, value in document.items() if key != "figures"})
    assert (document["source"], document["env_steps"]) == ("replay", 0)
    assert document["transitions"] == 2 * 200, "two tasks with rings of 400, half full"
    assert len(document["seeds"]) == 2
    assert all(0 < len(seed["loss"]) <= 61 for seed in document["seeds"])
    assert main(["adapt", str(finished), "--reward", "velocity", *SMALL, "--json"]) == 0
    (task, _) = json.loads(capsys.readouterr().out)["tasks"]
    assert list(task["answers"]) == ["map", "imagined", "search"]
    assert main(["adapt", str(finished), "--reward", "velocity", *SMALL]) == 0
    text = capsys.readouterr().out
    assert "imagined: from what `ear imagine` learnt, 0 env steps" in text
    assert "search: by the cross-entropy method, 1,600 env steps" in text


@pytest.mark.slow
def test_a_profile_is_followed(finished, few, capsys):
    small = ["--epochs", "2", "--candidates", "10", "--starts", "1", "--episodes", "2", "--no-film"]
    assert main(["follow", str(finished), "--profile", "0:1, 2:3", *small, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    del document["survey_env_steps"]  # of the command alone
    check_keys("following", {key: value for key, value in document.items() if key != "figures"})
    assert document["env_steps"] == 2 * 2 * 10 * 1 * 40
    for seed in document["seeds"]:
        assert list(seed["ways"]) == ["look-up", "spline"]
        assert all(len(way["followed"]) == len(way["ltes"]) == 40 for way in seed["ways"].values())
    (figure,) = [path for path in document["figures"] if path.endswith("seed0.png")]
    assert "following_profile-0-1-2-3" in figure


@pytest.mark.slow
def test_from_most_starts_a_square_is_met_within_a_metre(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    square = "6 0, 6 6, 0 6, 0 0"
    assert main(["follow", "pretrained:ant-dir", "--path", square, "--episodes", "4", "--no-film", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    (seed,) = document["seeds"]
    assert list(seed["ways"]) == ["look-up", "pursuit"]
    assert (
        statistics.median(seed["ways"]["pursuit"]["errors"]) < 1 < statistics.median(seed["ways"]["look-up"]["errors"])
    )
    assert any(path.endswith("seed1.png") for path in document["figures"])


def test_of_a_search_and_the_map_the_lte_that_returned_more_is_saved():
    answer = {"lte": [0.0, 1.0], "reevaluated": -57.4}
    task = {"lte": [1.0, 0.0], "epochs": [{"reevaluated": -50.0}, {"reevaluated": -60.9}], "zero_shot": answer}
    assert better(task) == ("map", [0.0, 1.0])
    assert better({**task, "zero_shot": {**answer, "reevaluated": -61.0}}) == ("search", [1.0, 0.0])
    assert better({**task, "zero_shot": None}) == ("search", [1.0, 0.0])
    assert better({**task, "epochs": []}) == ("map", [0.0, 1.0])
