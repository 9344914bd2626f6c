"""Running the missing parts of a table or figure, and the rules for what is missing."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from ear_jax.config import run_name
from ear_jax.errors import RunError
from ear_jax.runs import records
from ear_jax.runs.lock import lock_directory
from experiments import inventory, reproduce
from experiments.__main__ import main
from experiments.inventory import is_complete, is_trained, jobs, missing
from experiments.paper import EXPERIMENTS
from tests.helpers.fake_records import write_run


def test_what_is_missing_is_run_and_then_nothing_is(workplace):
    assert main(["reproduce", "table-8", "--seeds", "1"]) == 0
    runs = [f"ant-dir-ear-fast{variant}-seed0" for variant in ("", "+no-noise")]
    train, evaluate = "train ant-dir --agent ear --preset fast", "evaluate runs/{} --episodes 20 --json"
    export = "export runs/{0} records/.{0}.part/policy.safetensors"
    assert workplace == [
        f"{train} --seed 0",
        export.format(runs[0]),
        evaluate.format(runs[0]),
        f"{train}+no-noise --seed 0",
        export.format(runs[1]),
        evaluate.format(runs[1]),
    ]
    document = json.loads((inventory.RECORDS / runs[0] / "evaluation.json").read_text())
    assert (document["answer"], document["command"]) == (3, "ear " + workplace[2])
    assert {"machine", "versions", "commit"} <= set(document)
    workplace.clear()
    assert main(["reproduce", "table-8", "--seeds", "1"]) == 0
    assert workplace == []
    (inventory.RECORDS / runs[1] / "evaluation.json").unlink()
    assert main(["reproduce", "table-8", "--seeds", "1"]) == 0
    assert workplace == [evaluate.format(runs[1])], "the run is there"


def test_a_refined_policy_is_written_into_the_record_and_analysed_there(workplace):
    run = "hopper-vel-ear-fast-seed0"
    assert main(["reproduce", "refined", "--seeds", "1", "--only", run]) == 0
    refined = f"records/{run}/refined.safetensors"
    words = [
        f"refine runs/{run} {refined} --json",
        f"evaluate {refined} --episodes 5 --json",
        f"interpolate {refined} --all-pairs --json",
    ]
    assert workplace[-3:] == words
    (inventory.RECORDS / run / "refinement.json").unlink()
    (inventory.RECORDS / run / "refined.safetensors").write_text("of a process that was killed")
    workplace.clear()
    assert main(["reproduce", "refined", "--seeds", "1", "--only", run]) == 0
    assert workplace == words, "the analyses of the refined policy too"
    assert not (inventory.RECORDS / run / "refined.safetensors").exists(), "the stand-in for `ear` writes none"


@pytest.mark.parametrize(
    "words", [["experiments", "reproduce", "table-1", "--dry-run"], ["ear_jax.cli.main", "--help"]]
)
def test_a_closed_pipe_ends_a_command_quietly(words):
    reader, writer = os.pipe()
    os.close(reader)
    place = Path(__file__).parents[2]
    done = subprocess.run([sys.executable, "-m", *words], cwd=place, stdout=writer, stderr=subprocess.PIPE, text=True)
    os.close(writer)
    assert (done.returncode, done.stderr) == (1, "")


def test_a_run_whose_flags_make_a_variant_counts_as_that(workplace):
    job = jobs(EXPERIMENTS["wide"], "fast", 1)[3]
    assert (job.name, is_trained(job)) == ("ant-dir-ear-fast+wide-seed0", False)
    write_run(inventory.RECORDS / job.name, dataclasses.replace(job.config, preset="fast"))
    assert is_trained(job)


def test_several_processes_share_a_table(workplace, capsys, monkeypatch):
    theirs, other = "ant-dir-ear-fast-seed0", contextlib.ExitStack()
    claim = other.enter_context(lock_directory(reproduce.RUNS / reproduce.IN_HAND / theirs, pytest.fail))
    assert not os.get_inheritable(claim)
    begun = []

    def pause() -> None:  # and the other process ends without having done anything
        begun[:] = workplace
        other.close()

    monkeypatch.setattr(reproduce, "pause", pause)
    assert main(["reproduce", "table-8", "--seeds", "1"]) == 0
    said = capsys.readouterr().err
    assert f"waiting for other processes, which are working on {theirs}" in said
    assert said.endswith("table-8 is complete: 2 runs\n")
    assert (len(begun), len(workplace)) == (3, 6)
    assert all("+no-noise" in line for line in begun)
    assert not any("+no-noise" in line for line in workplace[3:])


def test_a_record_is_analysed_where_its_run_is_not(workplace, tmp_path):
    assert main(["reproduce", "table-8", "--seeds", "1"]) == 0
    record = inventory.RECORDS / "ant-dir-ear-fast-seed0"
    (record / "evaluation.json").unlink()
    shutil.rmtree(tmp_path / "runs")
    workplace.clear()
    assert main(["reproduce", "table-8", "--seeds", "1"]) == 0
    assert workplace == [f"evaluate records/{record.name}/policy.safetensors --episodes 20 --json"]


def test_a_record_is_not_analysed_by_another_run_of_its_name(workplace, tmp_path):
    assert main(["reproduce", "table-8", "--seeds", "1"]) == 0
    record = inventory.RECORDS / "ant-dir-ear-fast-seed0"
    (record / "evaluation.json").unlink()
    with (tmp_path / "runs" / record.name / "metrics.jsonl").open("a") as rows:
        rows.write('{"epoch": 999}\n')
    workplace.clear()
    assert main(["reproduce", "table-8", "--seeds", "1"]) == 0
    assert workplace == [f"evaluate records/{record.name}/policy.safetensors --episodes 20 --json"]


def test_training_again_drops_the_analyses_of_the_run_before(workplace):
    job = jobs(EXPERIMENTS["table-15"], "fast", seeds=1)[0]
    write_run(job.record, job.config, epoch=1)
    (job.record / "adaptation.json").write_text("{}")
    assert not is_trained(job)
    assert missing(job) == list(job.analyses)
    assert main(["reproduce", "table-15", "--seeds", "1"]) == 0
    assert is_complete(job)
    assert not (job.record / "adaptation.json").exists()


def test_a_run_counts_by_its_settings_and_its_budget(workplace):
    job = jobs(EXPERIMENTS["figure-9"], "fast", seeds=1)[0]
    for config, row, expected in (
        (job.config, {}, True),
        (dataclasses.replace(job.config, minutes=3.0, engine="native"), {}, True),
        (dataclasses.replace(job.config, sac=dataclasses.replace(job.config.sac, lr=1e-4)), {}, False),
        (job.config, {"epoch": job.config.epochs - 1}, False),
    ):
        write_run(job.record, config, **row)
        assert is_trained(job) == expected
    half = dataclasses.replace(job, config=dataclasses.replace(job.config, minutes=1.0))
    assert is_trained(half), "60 seconds are its minute"
    document = json.loads((job.record / "config.json").read_text())
    document["config"]["forgotten"] = 1
    records.write_json(job.record / "config.json", document)
    assert not is_trained(half)
    shutil.rmtree(job.record)
    assert not is_trained(half)


def test_seeds_trained_side_by_side_are_one_record_and_count_each(workplace):
    wanted = jobs(EXPERIMENTS["table-15"], "fast")
    together = dataclasses.replace(wanted[1].config, seeds=2)
    place = inventory.RECORDS / run_name(together)
    write_run(place, together)
    (place / "policy.safetensors").touch()
    assert place.name == "halfcheetah-vel-ear-fast-seeds1-2"
    assert [is_trained(job) for job in wanted] == [False, True, True]
    assert main(["reproduce", "table-15"]) == 0
    analysis = f"interpolate records/{place.name}/policy.safetensors --all-pairs --json"
    assert workplace[-1] == analysis, "of both at once"
    assert workplace.count(analysis) == 1
    assert all(is_complete(job) for job in wanted)


def test_seeds_are_trained_one_by_one_where_their_record_is_of_other_settings(workplace):
    wanted = jobs(EXPERIMENTS["table-15"], "fast", seeds=2)
    config = wanted[0].config
    other = dataclasses.replace(config, seeds=2, sac=dataclasses.replace(config.sac, lr=1e-4))
    write_run(place := inventory.RECORDS / run_name(other), other)
    assert main(["reproduce", "table-15", "--seeds", "2"]) == 0
    assert all(is_complete(job) for job in wanted)
    assert sorted(path.name for path in place.iterdir()) == ["config.json", "metrics.jsonl"], "it stays as it was"


def test_seeds_that_are_lacking_are_trained_together(workplace):
    """There are two methods, and one of them has a seed already."""
    assert main(["reproduce", "table-8", "--seeds", "1"]) == 0
    workplace.clear()
    shutil.rmtree(inventory.RECORDS / "ant-dir-ear-fast+no-noise-seed0")
    assert main(["reproduce", "table-8", "--together"]) == 0
    assert [words for words in workplace if words.startswith("train")] == [
        "train ant-dir --agent ear --preset fast+no-noise --seed 0 --seeds 3",
        "train ant-dir --agent ear --preset fast --seed 1 --seeds 2",
    ]
    workplace.clear()
    assert main(["reproduce", "table-8"]) == 0
    assert workplace == [], "each seed is there"
    (inventory.RECORDS / "ant-dir-ear-fast-seeds1-2" / "evaluation.json").unlink()
    assert main(["reproduce", "table-8", "--together", "--only", "ant-dir-ear-fast-seeds1-2"]) == 0
    assert [words.split()[0] for words in workplace] == ["evaluate"], "by the name that it was given"


def test_dry_run_prints_the_commands_and_writes_nothing(workplace, capsys, tmp_path):
    assert main(["reproduce", "table-4", "--preset", "paper", "--seeds", "2", "--minutes", "9", "--dry-run"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 2 * 6
    assert lines[0] == "ear train halfcheetah-vel --agent ear --preset paper --seed 0 --minutes 9"
    assert lines[3] == "ear interpolate runs/halfcheetah-vel-ear-paper-seed0 --between 2 3 --target 2.2 --json"
    assert (workplace, list(tmp_path.iterdir())) == ([], [])


def test_list_tells_what_is_there(workplace, capsys):
    assert main(["reproduce", "table-15", "--seeds", "1"]) == 0
    capsys.readouterr()
    assert main(["list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert sum(bool(re.match(r"│ (table|figure)-\d+ ", line)) for line in lines) == 31
    assert re.search(r"│ 1/3 +│ 1/3 +│", next(line for line in lines if "table-15" in line))


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        ("", "unknown command ''"),
        ("lst", "did you mean 'list'"),
        ("reproduce tabel-4", "did you mean 'table-4'"),
        ("reproduce table-1 --preset fats", "did you mean 'fast'"),
        ("reproduce table-1 --seeds 0", "must be at least 1"),
        ("reproduce table-1 --dry", "did you mean --dry-run? (`python -m experiments reproduce --help`"),
    ],
)
def test_a_mistake_gets_one_line(words, complaint, workplace, capsys):
    assert main(words.split()) == 2
    error = capsys.readouterr().err
    assert complaint in error
    assert (error[:13], error.count("\n")) == ("experiments: ", 1)


def test_help_names_the_commands(capsys):
    assert main(["--help"]) == 0
    assert "commands: list, reproduce, keep, report, publish" in capsys.readouterr().out


def test_a_command_that_fails_is_named_with_its_exit_code(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(RunError, match=r"`ear evaluate nowhere` ended with exit code 2"):
        reproduce.run_ear(["evaluate", "nowhere"])
    assert "nowhere is not a run directory" in capfd.readouterr().err


def test_a_signal_is_passed_on_and_waited_for(tmp_path):
    """The running command is a stand-in that leaves a file when it begins and when it saves."""
    stand_in = tmp_path / "ear_jax" / "cli" / "main.py"
    stand_in.parent.mkdir(parents=True)
    for package in (tmp_path / "ear_jax", stand_in.parent):
        (package / "__init__.py").touch()
    stand_in.write_text(
        "import signal, sys, time\n"
        "def save(number, _):\n    open('saved', 'w').close()\n    sys.exit(128 + number)\n"
        "signal.signal(signal.SIGTERM, save)\n"
        "open('begun', 'w').close()\ntime.sleep(60)\n"
    )
    code = (
        "import sys; from experiments import reproduce; from ear_jax.process.stopping import Stopped\n"
        "try: reproduce.run_ear(['train'])\nexcept Stopped as stopped: sys.exit(stopped.exit_code)"
    )
    root = str(Path(reproduce.__file__).parents[1])
    line = ["nohup", sys.executable, "-c", f"import sys; sys.path[0] = {root!r}\n{code}"]
    ours = subprocess.Popen(line, cwd=tmp_path)
    for _ in range(1200):
        if (tmp_path / "begun").exists():
            break
        time.sleep(0.05)
    ours.send_signal(signal.SIGHUP)  # which this process ignores, as below nohup
    ours.terminate()
    assert ours.wait(timeout=30) == 143
    assert (tmp_path / "saved").exists()


@pytest.mark.slow
def test_a_figure_is_reproduced_for_real(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(inventory, "RECORDS", tmp_path / "records")
    words = ["reproduce", "table-15", "--preset", "smoke", "--seeds", "1"]
    assert main(words) == 0
    record = tmp_path / "records" / "halfcheetah-vel-ear-smoke-seed0"
    assert json.loads((record / "interpolation.json").read_text())["one_to_one"]["total"] == 2
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")}
    assert main(words) == 0
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")} == before
