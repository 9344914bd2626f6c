"""Records that `keep` writes: whole, of the right run, and nothing half-written when it is killed."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from ear_jax.config import run_name
from ear_jax.presets import preset_config
from ear_jax.runs import records
from experiments import inventory, reproduce
from experiments.__main__ import main
from tests.helpers.fake_records import write_run
from tests.helpers.faults import each_kill


def test_a_run_made_by_hand_is_kept(place, finished):
    assert main(["keep", str(finished)]) == 0
    kept = inventory.RECORDS / "halfcheetah-vel-ear-smoke-seeds0-1"
    assert sorted(path.name for path in kept.iterdir()) == ["config.json", "metrics.jsonl", "policy.safetensors"]
    assert [row["seed"] for row in records.read_rows(kept / "metrics.jsonl")][-2:] == [0, 1]
    assert main(["keep", str(place / "nowhere")]) == 2


def test_a_record_of_another_run_is_not_lost(place, finished, capsys):
    kept = inventory.RECORDS / "halfcheetah-vel-ear-smoke-seeds0-1"
    write_run(kept, preset_config("halfcheetah-vel", "smoke"))
    before = {path: path.read_bytes() for path in kept.iterdir()}
    assert main(["keep", str(finished)]) == 2
    assert f"{kept} records another run" in capsys.readouterr().err
    assert {path: path.read_bytes() for path in kept.iterdir()} == before
    assert main(["keep", str(finished), "--name", "halfcheetah-vel-tiny"]) == 0
    own = kept.with_name("halfcheetah-vel-tiny")
    assert (own / "metrics.jsonl").read_bytes() == (finished / "metrics.jsonl").read_bytes()
    assert main(["keep", str(finished), "--name", "../away"]) == 2
    assert "cannot name a record" in capsys.readouterr().err


def contents(directory: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in directory.iterdir()} if directory.exists() else {}


@pytest.mark.parametrize("before", ["nothing", "the same run", "another run"])
def test_killed_at_any_change_a_record_is_the_one_before_or_the_new_one_or_none(before, workplace, tmp_path):
    config = preset_config("halfcheetah-vel", "smoke")
    run, record = tmp_path / "runs" / run_name(config), inventory.RECORDS / run_name(config)
    write_run(run, config)

    def prepare() -> None:
        shutil.rmtree(inventory.RECORDS, ignore_errors=True)
        if before != "nothing":
            write_run(record, config, **({} if before == "the same run" else {"seconds": 1.0}))
            (record / "evaluation.json").write_text("{}")

    prepare()
    one = contents(record)
    reproduce.keep(run, replace=True)
    whole = contents(record)
    assert set(whole) - {"evaluation.json"} == {"config.json", "metrics.jsonl", "policy.safetensors"}
    assert ("evaluation.json" in whole) == (before == "the same run")
    for _ in each_kill(prepare, lambda: reproduce.keep(run, replace=True)):
        assert contents(record) in ([one, {**one, "policy.safetensors": b"policy"}, whole, {}])
        reproduce.keep(run, replace=before == "another run")
        assert contents(record) == whole
        assert not list(inventory.RECORDS.glob(".*"))


def test_damaged_metrics_are_not_recorded(place, finished, capsys):
    path = finished / "metrics.jsonl"
    path.write_text(path.read_text().replace('"epoch": 6', '"epoch": 7', 1))
    assert main(["keep", str(finished)]) == 1
    assert "metrics.jsonl is damaged: line 5: it differs from its checksum" in capsys.readouterr().err
    assert not inventory.RECORDS.exists()


def test_a_run_without_a_policy_leaves_no_record(place, finished):
    shutil.rmtree(finished / "checkpoints")
    assert main(["keep", str(finished)]) == 1
    assert not list(inventory.RECORDS.glob("*/*"))
