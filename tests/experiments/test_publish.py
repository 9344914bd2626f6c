"""`python -m experiments publish`: a card agrees with its record, and an agent that cannot ship is refused."""

from __future__ import annotations

import contextlib
import hashlib
import json
import re
import shutil
from pathlib import Path

import jax
import numpy as np
import pytest

from ear_jax import pretrained
from ear_jax.envs import make_family
from ear_jax.errors import RunError, UsageError
from ear_jax.presets import preset_config
from ear_jax.runs import records
from ear_jax.runs.card import CURVE_POINTS, command_line, judge, limits, thinned
from ear_jax.runs.export import read_about, read_policy, write_policy
from ear_jax.runs.model_card import to_markdown
from ear_jax.runs.trained import load
from experiments import publish
from experiments.__main__ import main
from experiments.inventory import RECORDS
from tests.helpers.faults import each_kill, flips

POLICY, METRICS, EVALUATION = "policy.safetensors", "metrics.jsonl", "evaluation.json"


@pytest.fixture
def record(tmp_path) -> Path:
    return Path(shutil.copytree(RECORDS / "hopper-vel-ear-fast-seed0", tmp_path / "record"))


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    """Makes an empty folder for agents."""
    monkeypatch.setattr(pretrained, "FOLDER", tmp_path / "agents")
    pretrained.FOLDER.mkdir()
    return pretrained.FOLDER


def test_a_record_becomes_an_agent_that_loads(record, folder, capsys):
    assert main(["publish", str(record)]) == 0
    printed = capsys.readouterr().out
    assert re.match(r"pretrained:hopper-vel: [\d,]+ bytes, mean return [\d.]+\nMeets \d+ of 10 tasks", printed)
    assert (folder / "hopper-vel.safetensors").read_bytes() == (record / POLICY).read_bytes()
    card, last = pretrained.card("hopper-vel"), records.read_rows(record / METRICS)[-1]
    assert (card["env_steps"], card["updates"]) == (last["env_steps"], last["updates"])
    assert card["minutes"] == round(last["seconds"] / 60, 1)
    evaluation = json.loads((record / EVALUATION).read_text())
    assert card["mean_return"] == evaluation["mean_return"]
    assert (card["returns_from"], card["episodes"]) == ("evaluation.json", evaluation["episodes"])
    assert card["learning_curve"][-1]["mean_return"] == round(last["mean_return"], 2)
    assert load(Path("pretrained:hopper-vel")).epoch == last["epoch"]


def test_without_an_evaluation_returns_are_the_last_rows_and_limits_unknown(record, folder):
    (record / EVALUATION).unlink()
    assert main(["publish", str(record), "--name", "another"]) == 0
    card, last = pretrained.card("another"), records.read_rows(record / METRICS)[-1]
    assert {task["name"]: task["return"] for task in card["tasks"]} == last["returns"]
    assert (card["mean_return"], card["returns_from"]) == (last["mean_return"], "metrics.jsonl, last row")
    assert card["limits"] == "It has not been evaluated: which tasks it meets is not known."


def test_a_refined_policy_ships_with_its_costs_and_those_it_was_chosen_among(record, folder):
    assert main(["publish", str(record), "--refined"]) == 0
    card, plain = pretrained.card("hopper-vel"), records.read_rows(record / METRICS)[-1]
    (refined,) = json.loads((record / "refinement.json").read_text())["seeds"]
    evaluation = json.loads((record / "refined-evaluation.json").read_text())
    assert (folder / "hopper-vel.safetensors").read_bytes() == (record / "refined.safetensors").read_bytes()
    assert card["mean_return"] == evaluation["mean_return"]
    assert card["env_steps"] == plain["env_steps"] + card["refined"]["env_steps"] == evaluation["env_steps"]
    assert card["refined"]["mean_returns"] == [pytest.approx([refined["before"], refined["after"]], abs=1e-3)]
    others = [json.loads(path.read_text()) for path in RECORDS.glob("hopper-vel-ear-fast-seed*/refinement.json")]
    returns = [entry["after"] for document in others for entry in document["seeds"]]
    assert (card["seeds"], card["mean_of_seeds"]) == (len(returns), pytest.approx(np.mean(returns)))
    assert f"{card['seeds']} seeds, mean return {card['mean_of_seeds']:.1f}" in to_markdown(card, "a.safetensors")
    own = to_markdown({**card, "family": "my.py:Own"}, "a.safetensors")
    assert "ear evaluate a.safetensors --family my.py:Own\n" in own


def of_two_seeds(record: Path) -> None:
    """Adds a second seed to a record: the first's policy negated, with returns lower by one."""
    about, header = read_about(record / POLICY)
    arrays = read_policy(record / POLICY, header)
    about["config"]["seeds"] = 2
    twice = jax.tree.map(lambda leaf: np.concatenate([leaf, -leaf]), load(record / POLICY).policies)
    write_policy(record / POLICY, twice, np.concatenate([arrays["codes"]] * 2), about, "")
    rows = records.read_rows(record / METRICS)
    lower = [{**row, "seed": 1, "mean_return": row["mean_return"] - 1} for row in rows]
    both = [row for pair in zip(rows, lower, strict=True) for row in pair]
    (record / METRICS).write_text("".join(f"{json.dumps(row)}\n" for row in both))
    evaluation = json.loads((record / EVALUATION).read_text())
    first = evaluation["seeds"][0]
    evaluation["seeds"].append({**first, "seed": 1, "mean_return": first["mean_return"] - 1})
    records.write_json(record / EVALUATION, evaluation)


def test_of_several_seeds_one_ships(record, folder, capsys):
    first = load(record / POLICY)
    of_two_seeds(record)
    assert main(["publish", str(record), "--policy", "1"]) == 0
    card, shipped = pretrained.card("hopper-vel"), load(Path("pretrained:hopper-vel"))
    for one, two in zip(jax.tree.leaves(shipped.policies), jax.tree.leaves(first.policies), strict=True):
        np.testing.assert_array_equal(one, -two)
    assert (card["seed"], card["side_by_side"], card["command"]) == (1, 2, "ear train hopper-vel --seeds 2")
    evaluated = json.loads((record / EVALUATION).read_text())["seeds"][1]["mean_return"]
    last = records.read_rows(record / METRICS)[-1]
    assert (card["mean_return"], last["seed"]) == (evaluated, 1)
    assert card["learning_curve"][-1]["mean_return"] == round(last["mean_return"], 2)
    assert main(["publish", str(record), "--policy", "2"]) == 2
    assert "--policy 2 is out of range: this run has 2 policies, numbered from 0" in capsys.readouterr().err


def of_another_seed(record: Path) -> None:
    document = json.loads((record / EVALUATION).read_text())
    document["seeds"][0]["seed"] = 7
    records.write_json(record / EVALUATION, document)


def evaluated_before(record: Path) -> None:
    document = json.loads((record / EVALUATION).read_text())
    records.write_json(record / EVALUATION, {**document, "updates": 2})


def measured_before(record: Path) -> None:
    rows = records.read_rows(record / METRICS)
    (record / METRICS).unlink()
    records.append_rows(record / METRICS, rows[:-1])


@pytest.mark.parametrize(
    ("harm", "code", "complaint"),
    [
        (shutil.rmtree, 2, "there is no such directory"),
        (lambda record: (record / POLICY).unlink(), 1, "has no policy.safetensors, which `ear export` writes"),
        (lambda record: (record / METRICS).unlink(), 1, "has no metrics.jsonl, which `ear train` writes"),
        (measured_before, 1, ", for which metrics.jsonl has no row"),
        (evaluated_before, 1, "is from 2 updates and the policy from "),
        (lambda record: (record / EVALUATION).write_text("{"), 1, "evaluation.json cannot be read"),
        (lambda record: (record / POLICY).write_bytes(b"x"), 1, "is not a complete safetensors file"),
        (of_another_seed, 1, "evaluation.json lacks seed 0; run `ear evaluate` again"),
        (of_two_seeds, 2, "holds 2 seeds and an agent has one: choose it with --policy 0 to 1"),
    ],
)
def test_what_cannot_ship_is_refused_in_one_line(harm, code, complaint, record, folder, capsys):
    harm(record)
    assert main(["publish", str(record)]) == code
    error = capsys.readouterr().err
    assert complaint in error
    assert (error[:13], error.count("\n")) == ("experiments: ", 1)
    assert list(folder.iterdir()) == []


@pytest.mark.parametrize("before", [True, False])
def test_killed_at_any_change_an_agent_is_the_one_before_or_the_new_one(before, folder, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    agents = {content: {"name": "a", "sha256": hashlib.sha256(content).hexdigest()} for content in (b"one", b"two")}

    def prepare() -> None:
        for path in folder.iterdir():
            path.unlink()
        if before:
            publish.ship("a", b"one", agents[b"one"])

    seen = set()
    for _ in each_kill(prepare, lambda: publish.ship("a", b"two", agents[b"two"])):
        if pretrained.names():
            content = pretrained.find("a").read_bytes()
            assert pretrained.card("a") == agents[content]
            seen.add(content)
        publish.ship("a", b"two", agents[b"two"])
        assert pretrained.find("a") == folder / "a.safetensors"
        assert {path.name for path in folder.iterdir()} == {"a.safetensors", "a.json"}
    assert seen == ({b"one", b"two"} if before else {b"two"})


HARMED = (POLICY, METRICS, EVALUATION)


@pytest.mark.parametrize("count", [10, pytest.param(400, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", HARMED)
def test_a_flipped_bit_in_a_record_makes_no_other_card(name, count, record, folder, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    good = publish.publish(record)
    path = record / name
    content = path.read_bytes()
    for flipped in flips(content, count):
        path.write_bytes(flipped)
        with contextlib.suppress(RunError, UsageError):
            assert publish.publish(record) == good
    path.write_bytes(content)


def test_sizes_are_limited(record, folder, monkeypatch, capsys):
    size = (record / POLICY).stat().st_size
    monkeypatch.setattr(publish, "FILE_BYTES", size - 1)
    assert main(["publish", str(record)]) == 1
    assert f"has {size:,} bytes; an agent may have at most {size - 1:,}" in capsys.readouterr().err
    monkeypatch.setattr(publish, "FILE_BYTES", size)
    monkeypatch.setattr(publish, "ALL_BYTES", 2 * size - 1)
    for _ in range(2):  # the second replaces the first
        assert main(["publish", str(record), "--name", "one"]) == 0
    assert main(["publish", str(record), "--name", "two"]) == 1
    assert f"all agents would have {2 * size:,} bytes; the limit is {2 * size - 1:,}" in capsys.readouterr().err


def test_a_name_is_a_plain_word(record, folder, capsys):
    assert main(["publish", str(record), "--name", "../away"]) == 2
    assert "cannot name an agent" in capsys.readouterr().err


def test_a_task_is_met_within_half_way_to_the_next_one():
    def met(family: str, target: float | None, achieved: float, failures: int = 0) -> bool:
        measured = make_family(family)
        numbers = {"target": target, "return_mean": 1.0, "failures": failures, "name": "x"}
        others = [{"target": other} for other in (0.0, 2.0, 358.0, None)]
        return judge(measured, {**numbers, "outcome": {measured.commanded: achieved}}, others)["met"]

    assert met("hopper-vel", 2.0, 2.9)
    assert not met("hopper-vel", 2.0, 3.1)
    assert not met("hopper-vel", 2.0, 2.0, failures=1)
    assert met("ant-dir", 0.0, 359.5)
    assert not met("ant-dir", 0.0, 358.5)


def test_the_only_target_is_not_judged():
    measured = make_family("hopper-vel")
    task = {"name": "5", "target": 5.0, "return_mean": 1.0, "failures": 0, "outcome": {measured.commanded: 4.0}}
    judged = judge(measured, task, [task])
    assert judged["error"] == 1
    assert "met" not in judged


def test_a_task_without_a_target_is_not_judged():
    task = {"name": "jump", "target": None, "return_mean": 1.0, "failures": 0, "outcome": {"height": 1.5}}
    judged = judge(make_family("hopper-vel"), task, [task])
    assert judged == {"name": "jump", "target": None, "return": 1.0, "failures": 0, "outcome": {"height": 1.5}}


def test_limits_are_told_in_a_sentence():
    met = {"name": "a", "met": True, "failures": 0}
    off = {"name": "b", "met": False, "failures": 0, "achieved": 0.123}
    over = {"name": "c", "met": False, "failures": 2}
    assert limits([met, met], 5, "m/s") == "Meets 2 of 2 tasks."
    told = "Meets 1 of 3 tasks; achieves (m/s) 0.12 for b; ends early in c (2 of 5 episodes)."
    assert limits([met, off, over], 5, "m/s") == told
    free = {"name": "d", "failures": 1, "outcome": {"height": 1.5, "velocity": 0.0}}
    told = "ends early in d (1 of 5 episodes); on tasks without a target has d (height 1.50, velocity 0.00)."
    assert limits([met, free], 5, "m/s") == f"Meets 1 of 1 tasks; {told}"
    assert limits([free], 5, "m/s") == f"E{told[1:]}"


def test_a_command_names_what_differs_from_the_preset():
    config = preset_config("hopper-vel", "fast+no-noise", "ear")
    assert command_line(config) == "ear train hopper-vel --preset fast+no-noise"
    smoke = preset_config("hopper-vel", "smoke", "multihead")
    assert command_line(smoke) == "ear train hopper-vel --preset smoke --agent multihead"


def test_a_learning_curve_is_thinned_to_its_end():
    rows = [{"seconds": 60.0 * n, "env_steps": n, "updates": n, "mean_return": n} for n in range(101)]
    points = thinned(rows)
    assert len(points) <= CURVE_POINTS
    assert points[-1] == {"minutes": 100.0, "env_steps": 100, "updates": 100, "mean_return": 100}
    assert len(thinned(rows[:3])) == 3
