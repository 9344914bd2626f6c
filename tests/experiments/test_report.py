"""The report of made-up records, against values worked out by hand."""

from __future__ import annotations

import dataclasses
import json
import re

import numpy as np
import pytest

from ear_jax.embeddings import interpolate
from ear_jax.presets import preset_config
from ear_jax.runs import records, safetensors
from experiments.inventory import POLICY
from experiments.report import comparison, formatting, measures, tables
from experiments.report.blocks import Section, Table
from experiments.report.glance import glance
from experiments.report.run_index import RunIndex
from tests.helpers.fake_records import SPEEDS, add, add_pairs, cells, record, section


def test_returns_are_the_mean_over_seeds_with_interval_and_chance_of_being_better(place):
    for seed, level in enumerate((-200, -210, -190)):
        record(seed=seed, level=level)
        record(agent="multihead", seed=seed, level=level - 100)
    assert all(run.changes == {} for run in RunIndex("fast").all())
    text = section("table-1", place / "out")
    ours, baseline = cells(text, "EAR-SAC"), cells(text, "MHMT-SAC")
    assert ours[1:3] == ["−136.9 ± 1.29", "−195.5 ± 10.0"]
    middle, low, high = (float(number) for number in re.findall(r"-\d+\.\d", ours[3].replace("−", "-")))
    assert low < middle == -195.5 < high
    assert ours[4:] == ["—", "3 seeds", "800,000", "80,000", "40.0"]
    assert baseline[4] == "1.00 [1.00, 1.00]"
    assert cells(text, "PEARL")[2] == "—, no run yet"
    assert text.count("`ear train halfcheetah-vel --agent multihead --seed 2`") == 1


def test_the_papers_one_hot_is_held_against_ours_with_it_and_without(place):
    record(agent="onehot", level=-200)
    for seed, level in enumerate((-500, -510)):
        record(agent="onehot-blind", seed=seed, level=level)
    said = section("comparison", place / "out")
    ours = "with its one-hot −195.5 (1 seed), with the one-hot zeroed −500.5 ± 7.1 (2 seeds)"
    assert f"HalfCheetah-Vel: OHE-SAC {ours}; the paper's OHE-SAC −609.0 ± 8.10." in said


def test_the_papers_comparisons_are_set_beside_ours(place):
    for seed in (0, 1):
        record(seed=seed, level=-150 - seed)
        record(agent="onehot", seed=seed, level=-200)
    said = section("comparison", place / "out")
    assert "than one of OHE-SAC on the same task is 1.00 [1.00, 1.00] on HalfCheetah-Vel; chance is 0.5." in said
    assert "LTE noise against failures" not in said, "without runs there is nothing to compare"


def test_of_seeds_trained_side_by_side_it_is_told_how_many_and_where(place):
    path = record(seeds=2) / "config.json"
    made = json.loads(path.read_text())
    records.write_json(path, {**made, "machine": {**made["machine"], "accelerator": "H100"}})
    assert cells(section("runs", place / "out"), "halfcheetah-vel-ear-fast-seed0")[7] == "H100, 2 seeds side by side"


def test_how_far_apart_neighbours_embeddings_are(place):
    record(preset="fast+gathered")
    directory = record(seeds=2)
    rows = directory / "metrics.jsonl"
    records.append_rows(rows, [{**row, "seed": 1} for row in records.read_rows(rows)])
    around = np.radians([[10.0 * index for index in range(10)], [0, 180, 170, 160, 150, 140, 130, 120, 110, 100]])
    codes = np.stack([np.cos(around), np.sin(around), 0 * around], axis=-1).astype(np.float32)
    safetensors.write(directory / POLICY, {"codes": codes}, {})
    assert cells(section("gathered", place / "out"), "HalfCheetah-Vel")[6] == "—", "no pairs, no gaps"
    add_pairs(directory, 1, 9)
    assert cells(section("gathered", place / "out"), "HalfCheetah-Vel")[6] == "180°"
    assert len(measures.gaps(RunIndex("fast").runs("halfcheetah-vel")[0])) == 0, "the pairs are the other seed's"
    add_pairs(directory, 0, 9)
    assert measures.gaps(RunIndex("fast").runs("halfcheetah-vel")[0]) == pytest.approx([10] * 9, abs=1e-3)


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
    costs = "costs at most 66 of the 105.5 points that we lose"
    assert costs in said, "of −105.5 at 0.1 + 0.1 a step 200 steps explain −40"
    assert "vel-10 and vel-9, contribute −21.9 to the mean return of −105.5" in said
    assert "- HalfCheetah-Vel, return: −105.5 (1 seed); the paper −136.9 ± 1.29." in said.partition("Level with")[0], (
        "above"
    )


def test_only_seeds_that_tell_are_counted(place):
    add_pairs(record(seed=0), 0, 9)
    record(seed=1)
    assert cells(section("table-5", place / "out"), "HalfCheetah-Vel | mid-task")[5] == "9 of 9 (1 seed)"


def test_interpolation_of_all_seeds_is_counted_together(place):
    for seed, successes in enumerate((9, 8)):
        add_pairs(record(seed=seed), seed, successes)
    text = section("table-5", place / "out")
    assert cells(text, "HalfCheetah-Vel")[1:] == ["mid-task, again", *"———", "15 of 18 (2 seeds), off by 0.02 m/s"]
    assert cells(text, "HalfCheetah-Vel | mid-task")[2:] == ["26 of 27", "26 of 27", "18 of 18", "17 of 18 (2 seeds)"]
    assert cells(text, "HalfCheetah-Vel | 1:1")[2:] == ["25 of 27", "26 of 27", "18 of 18", "15 of 18 (2 seeds)"]
    midway = section("table-11", place / "out")
    paper, ours = ["0.47 → 1.60", "0.42 → 1.51", "0.37 → 1.49"], ["0.40 → 1.51 (1.52)"] * 2
    assert cells(midway, "1.5") == ["1.5", *paper, *ours]
    assert "ours 0.010 [0.010, 0.010] m/s (2 seeds), in fresh episodes 0.020 [0.020, 0.020] m/s (2 seeds)" in midway
    assert cells(section("table-15", place / "out"), "2.5")[4:] == ["2.60", "2.70", "2.65 ± 0.07"]
    said = section("comparison", place / "out")
    short = said.partition("Short of")[2]
    assert "the blend at β = ½ lies between the two: 15 of 18 pairs (2 seeds); the paper 25 of 27." in short


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
    for variant, lengths in (("", [200, 200]), ("+no-noise", [200, 150])):
        directory = record("ant-dir", preset=f"fast{variant}")
        tasks = [
            {
                "name": f"dir-{name}",
                "target": name,
                "return_mean": 1.0,
                "failures": failures,
                "episodes": {"length": length},
            }
            for name, failures, length in ((0, int(lengths[1] < 200), lengths), (240, 0, [200, 200]))
        ]
        add(directory, "evaluation", seeds=[{"seed": 0, "tasks": tasks}])
    text = section("table-8", place / "out")
    assert cells(text, "without noise")[1:] == ["16 of 72", "1 of 2 (1 seed)"]
    assert cells(text, "with noise")[1:] == ["0 of 72", "0 of 2 (1 seed)"]
    text = section("table-7", place / "out")
    assert cells(text, "paper, dir-240, seed 5")[1:] == ["200", "102", "144", "200", "200"]
    assert cells(text, "ours, dir-240, seed 0")[1:] == ["200", "200", "—", "—", "—"]
    assert cells(text, "ours, dir-0, seed 0")[1:] == ["200", "150", "—", "—", "—"]
    said = section("comparison", place / "out").partition("Short of")[0]
    assert "Ant-Dir, tasks with an episode that ends early: 0 of 2; the paper 0 of 72." in said


def test_the_papers_successes_are_counted_again_from_its_lists():
    """Its table 5 follows from tables 11 to 14 exactly; of 15 to 18, table 18 has nine misses where it counts six."""
    for family in measures.BLENDED:
        counted = measures.paper_recount(family, "mid_task")
        assert str(counted) == formatting.printed(measures.paper_counts(family, "mid_task"))
    counted = [str(measures.paper_recount(family, "one_to_one")) for family in measures.BLENDED]
    assert counted == ["26 of 27", "27 of 27", "25 of 27", "63 of 72"]


def test_ours_are_counted_as_the_papers_from_the_blend_listed(place):
    directory = record()
    rows = [("vel-1", "vel-2", 1.5, 0.97, 1.55, 1.4), ("vel-2", "vel-3", 2.5, 0.5, 2.56, 3.1)]
    pairs = [
        {"between": [one, other], "target": target, "beta": beta, "outcome": outcome, "one_to_one_outcome": half}
        for one, other, target, beta, outcome, half in rows
    ]
    add(directory, "interpolation", pairs=[{"seed": 0, **pair} for pair in pairs])
    runs = RunIndex("fast").runs("halfcheetah-vel")
    counted = [str(measures.recount("halfcheetah-vel", runs, measure)) for measure in ("mid_task", "one_to_one")]
    assert counted == ["1 of 2", "1 of 2"]


def test_a_baseline_short_of_its_row_is_named(place):
    record(agent="multihead", level=-300)
    record(agent="onehot", level=-200)
    above, _, short = section("comparison", place / "out").partition("Level with")
    assert "HalfCheetah-Vel, OHE-SAC, return: −195.5 (1 seed); the paper −609.0 ± 8.10." in above
    assert "HalfCheetah-Vel, MHMT-SAC, return: −295.5 (1 seed); the paper −145.2 ± 2.60." in short


def test_what_tuning_gains_is_told_with_its_standard_error(place):
    for seed, (before, after) in enumerate(((-300.0, -240.0), (-310.0, -230.0))):  # gains of 60 and 80
        tasks = [{"name": "vel-1", "return_mean": after}]
        evaluation = {"seed": seed, "untuned_return": before, "mean_return": after, "tasks": tasks}
        add(record(agent="maml", seed=seed), "evaluation", seeds=[evaluation])
    said = section("comparison", place / "out")
    assert "−305.0 ± 7.1 with the parameters that all tasks share and −235.0 ± 7.1 after its gradient step" in said
    assert "a gain of 70.0 ± 10.0 (standard error), 2 seeds." in said


def test_a_run_with_other_tasks_or_another_reward_is_no_run_of_the_preset(place):
    record(tasks=("1", "2"))
    record("ant-dir", env=dataclasses.replace(preset_config("ant-dir", "fast").env, lateral_weight=1.0))
    assert RunIndex("fast").all() == []


def test_a_run_of_an_earlier_recipe_is_shown_with_what_was_otherwise(place):
    config = preset_config("halfcheetah-vel", "fast")
    record(sac=dataclasses.replace(config.sac, lr=3e-4), minutes=15.0, epochs=900)
    text = section("runs", place / "out")
    row = cells(text, "halfcheetah-vel-ear-fast-seed0")
    assert row[1:3] == ["seed 0", "900 of 900"]
    assert row[-1] == "sac.lr 0.0003"
    assert "`ear train halfcheetah-vel --epochs 900 --minutes 15 --sac.lr 0.0003`" in section("table-11", place / "out")


def test_a_run_whose_flags_make_a_variant_is_that_variants(place):
    network = dataclasses.replace(preset_config("ant-dir", "fast").network, width=512, matmul="bfloat16")
    record("ant-dir", network=network)
    assert RunIndex("fast").runs("ant-dir") == []
    (run,) = RunIndex("fast").runs("ant-dir", variant="+wide")
    assert run.changes == {}
    assert "`ear train ant-dir --preset fast+wide`" in section("wide", place / "out")


def test_of_two_runs_of_a_seed_that_with_todays_settings_is_told_of(place):
    config = preset_config("halfcheetah-vel", "fast")
    long = record(sac=dataclasses.replace(config.sac, lr_decay=400_000), epochs=900)
    long.rename(long.with_name("a-trial"))
    (run,) = RunIndex("fast").runs("halfcheetah-vel")
    assert run.name == "a-trial"
    made = record()
    (run,) = RunIndex("fast").runs("halfcheetah-vel")
    assert run.name == made.name


def test_seeds_trained_together_are_told_apart(place):
    directory = record(seeds=2)
    rows = records.read_rows(directory / "metrics.jsonl")
    records.append_rows(directory / "metrics.jsonl", [{**row, "seed": 1} for row in rows])
    assert [run.seed for run in RunIndex("fast").runs("halfcheetah-vel")] == [0, 1]
    assert cells(section("table-1", place / "out"), "EAR-SAC")[5] == "2 seeds"
    assert "`ear train halfcheetah-vel --seeds 2`" in section("table-1", place / "out")


def test_another_preset_has_its_own_runs(place):
    record(preset="paper")
    assert cells(section("table-1", place / "out"), "EAR-SAC")[2] == "—, no run yet"
    assert cells(section("table-1", place / "out", "paper"), "EAR-SAC")[2] == "−195.5"


def test_what_is_said_of_the_code_is_so():
    table = tables.interpolation_counts(RunIndex("fast"))[0]
    assert isinstance(table, Table)
    low, high = interpolate.MID_TASK_RANGE
    caption = f"between {low:g} and {high:g} meets the value midway, to within {100 * interpolate.REACHED:g} %"
    assert caption in table.caption
    assert f"We take {100 * interpolate.REACHED:g} % of the distance" in " ".join(comparison.WHY)
    assert isinstance(comparison.comparison(RunIndex("fast")), Section)


def test_a_goal_is_reached_within_five_centimetres(place):
    directory = record("reach")
    made = json.loads((directory / "config.json").read_text())
    goals = {"goal-0": (0.1, 0.85, 0.175), "goal-36": (0.0, 0.85, 0.3)}
    tasks = [{"name": name, "target": 0.0, "params": dict(zip("xyz", at, strict=True))} for name, at in goals.items()]
    records.write_json(directory / "config.json", {**made, "tasks": tasks})
    reached = [{"x": 0.1, "y": 0.81, "z": 0.205}, {"x": 0.0, "y": 0.85, "z": 0.36}]  # a 3-4-5 triangle, and 6 cm above
    found = [
        {"name": name, "target": 0.0, "return_mean": 1.0, "failures": 0, "outcome": outcome}
        for name, outcome in zip(goals, reached, strict=True)
    ]
    add(directory, "evaluation", seeds=[{"seed": 0, "tasks": found}])
    assert "| EAR-SAC | 1 of 2 | 5.5 | 6.0 |" in section("reach", place / "out")


def test_the_report_opens_with_verdicts_and_a_picture_of_all_returns(place):
    record(level=-140)
    record(level=-142, seed=1)
    add_pairs(record(agent="ear", seed=2, level=-141), 2, 9)
    record(agent="maml", level=-700)
    add(record(agent="multihead", level=-200), "refinement", seeds=[{"seed": 0, "before": -195.5, "after": -147.0}])
    verdicts, picture = glance(RunIndex("fast"), place / "out")
    rows = {name: cells for name, *cells in verdicts.rows}
    assert rows["EAR-SAC"] == ["✓ −136.5 ± 1.0 (3) / −136.9", "—", "—", "—"]
    assert rows["EAR-SAC, refined"] == ["—"] * 4
    assert rows["Blends: midway"][0] == "✓ 9 of 9 (1) / 26 of 27"
    assert rows["Blends: between"][0] == "✗ 8 of 9 (1) / 25 of 27"
    assert rows["MHMT-SAC"][0] == "✗ −195.5 (1) / −145.2"
    assert rows["MHMT-SAC, refined"][0] == "✓ −147.0 (1) / −145.2"
    assert rows["MAML"][0] == "✗ −695.5 (1) / −500.9"
    assert (place / "out" / picture.file).read_bytes().startswith(b"\x89PNG")


def test_without_records_there_is_no_verdict(place):
    (verdicts,) = glance(RunIndex("fast"), place / "out")
    assert all(set(cells) == {"—"} for _, *cells in verdicts.rows)


def test_methods_with_other_numbers_of_tasks_are_compared_on_those_that_both_have(place):
    for seed in range(2):
        record(seed=seed, level=-200)
        tasks = [
            {"name": f"vel-{number / 2:g}", "return_mean": -100.0 if number % 2 else -400.0} for number in range(1, 21)
        ]
        add(
            record(agent="maml", seed=seed), "evaluation", seeds=[{"seed": seed, "mean_return": -250.0, "tasks": tasks}]
        )
    row = cells(section("table-1", place / "out"), "MAML")
    assert row[2] == "−250.0 ± 0.0"
    assert row[4] == "1.00 [1.00, 1.00]", "on whole speeds, all of which return −400"
