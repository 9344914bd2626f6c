"""A policy in one file: it equals the run's, loads wherever a run does, and is refused if damaged."""

from __future__ import annotations

import json
import random
from pathlib import Path

import jax
import numpy as np
import pytest

from ear_jax.cli.main import main
from ear_jax.errors import RunError, UsageError
from ear_jax.runs import manifest, records, safetensors
from ear_jax.runs.export import read_about, write_policy
from ear_jax.runs.trained import load, save
from experiments.inventory import RECORDS
from tests.helpers.runs import finished_config, leaves


@pytest.fixture
def exported(finished, tmp_path, capsys) -> Path:
    file = tmp_path / "policy.safetensors"
    assert main(["export", str(finished), str(file), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert (document["file"], document["epoch"], document["bytes"]) == (str(file), 24, file.stat().st_size)
    assert "trained for 24 epochs, 520 env steps and 96 updates per seed, mean return -" in document["card"]
    return file


def test_the_file_is_the_runs_policy_without_its_replay(finished, exported):
    run, file = load(finished), load(exported)
    assert (file.name, file.epoch, file.collected) == (str(exported), 24, run.collected)
    for one, two in zip(leaves(run.policies), leaves(file.policies), strict=True):
        np.testing.assert_array_equal(one, two)
    assert file.program.tasks == run.program.tasks
    assert exported.stat().st_size < 50_000


def test_others_read_its_layout_and_its_code_table(finished, exported):
    """The test reads the file by the format's description alone."""
    content = exported.read_bytes()
    size = int.from_bytes(content[:8], "little")
    header = json.loads(content[8 : 8 + size])
    assert size % 8 == 0
    assert set(header["__metadata__"]) == {"format", "about", "card", "sha256_metadata", "sha256"}
    assert json.loads(header["__metadata__"]["about"])["config"]["network"]["width"] == 16
    begin, end = header["codes"]["data_offsets"]
    codes = np.frombuffer(content[8 + size + begin : 8 + size + end], "<f4").reshape(header["codes"]["shape"])
    run = load(finished)
    np.testing.assert_array_equal(codes, jax.vmap(run.program.agent.codes)(run.policies))
    assert codes.shape == (2, 2, 3)
    assert max(entry["data_offsets"][1] for entry in header.values() if "shape" in entry) == len(content) - 8 - size


def test_a_code_table_that_the_agent_found_is_stored_once(tmp_path):
    recorded = RECORDS / "hopper-vel-maml-fast-seed2" / "policy.safetensors"  # of a version that stored it twice
    run, file = load(recorded), tmp_path / "policy.safetensors"
    save(file, run, [])
    assert file.stat().st_size < 0.6 * recorded.stat().st_size
    assert load(file).fingerprint == run.fingerprint


def test_a_command_takes_it_for_a_run(exported, capsys):
    assert main(["evaluate", str(exported), "--episodes", "1", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert (document["run"], document["env_steps"], document["updates"]) == (str(exported), 520, 96)
    results = exported.parent / "policy-results"
    assert {path.name for path in results.iterdir()} == {"evaluation.json", "evaluation_episodes-1.json", "figures"}
    assert [path.name for path in (results / "figures").iterdir()] == ["commanded_achieved_episodes-1.png"]


def test_one_seed_of_several_is_as_if_trained_alone(finished, tmp_path, capsys):
    file, both = tmp_path / "second.safetensors", load(finished)
    assert main(["export", str(finished), str(file), "--policy", "1"]) == 0
    assert "seed 1, one of 2 trained together" in capsys.readouterr().out
    alone = load(file)
    assert (alone.program.config.seed, alone.program.config.seeds) == (1, 1)
    for one, two in zip(leaves(alone.policies), leaves(both.policies), strict=True):
        np.testing.assert_array_equal(one, two[1:])
    (last,) = (row for row in records.read_rows(finished / "metrics.jsonl") if (row["epoch"], row["seed"]) == (24, 1))
    assert f"mean return {last['mean_return']:.1f}" in safetensors.read(file)[1]["card"]
    assert main(["export", str(file), str(tmp_path / "again.safetensors")]) == 0
    assert load(tmp_path / "again.safetensors").fingerprint == alone.fingerprint
    assert main(["export", str(file), str(tmp_path / "other.safetensors"), "--policy", "1"]) == 2
    assert "--policy 1 is out of range: this run has 1 policy, number 0" in capsys.readouterr().err


@pytest.mark.parametrize("policy", [-1, 2])
def test_a_policy_that_a_run_does_not_have_is_named(policy, finished, tmp_path, capsys):
    assert main(["export", str(finished), str(tmp_path / "a.safetensors"), "--policy", str(policy)]) == 2
    assert f"--policy {policy} is out of range: this run has 2 policies, numbered from 0" in capsys.readouterr().err


def test_every_flipped_bit_is_found(exported):
    content = exported.read_bytes()
    dice = random.Random(0)
    for byte in (*dice.sample(range(len(content)), 100), *range(16)):
        flipped = bytearray(content)
        flipped[byte] ^= 1 << dice.randrange(8)
        exported.write_bytes(flipped)
        with pytest.raises(RunError, match=str(exported)):
            load(exported)


@pytest.mark.parametrize(
    "content", [b"", b"\x08", b"cos\nsystem\n(S'true'\ntR.", b"\xff" * 100, b"\x02" + b"\0" * 7 + b"[]"]
)
def test_what_is_no_such_file_is_refused(content, tmp_path):
    file = tmp_path / "policy.safetensors"
    file.write_bytes(content)
    with pytest.raises(RunError, match=f"{file} is not a "):
        load(file)


def test_an_array_that_points_outside_of_the_file_is_refused(tmp_path):
    file = tmp_path / "a.safetensors"
    safetensors.write(file, {"a": np.arange(4, dtype=np.float32)}, {"format": "x"})
    arrays, metadata = safetensors.read(file)
    np.testing.assert_array_equal(arrays["a"], [0, 1, 2, 3])
    assert metadata == {"format": "x"}
    file.write_bytes(file.read_bytes().replace(b"[0, 16]", b"[8, 24]"))
    with pytest.raises(RunError, match="an array's offsets are out of range"):
        safetensors.read(file)


def test_export_overwrites_nothing(finished, exported, capsys):
    assert main(["export", str(finished), str(exported)]) == 2
    assert "already exists; name another file" in capsys.readouterr().err
    assert main(["export", str(finished), "policy.pt"]) == 2
    assert "must end in .safetensors" in capsys.readouterr().err


def test_code_is_run_only_where_the_user_names_it(exported, finished, tmp_path):
    """The checkpoint and the file are valid, and name a Python file as their family."""
    evil = tmp_path / "evil.py"
    evil.write_text(f"open({str(tmp_path / 'ran')!r}, 'w')")
    policies, step = load(exported), finished / "checkpoints" / "24"
    about = json.loads((step / "about.json").read_text())
    about["config"]["family"] = f"{evil}:Family"
    records.write_json(step / "about.json", about)
    manifest.write(step)
    described = {**about, "collected": 26}
    write_policy(tmp_path / "evil.safetensors", policies.policies, np.zeros((2, 2, 3), np.float32), described, "")
    for path in (finished, tmp_path / "evil.safetensors"):
        with pytest.raises(UsageError, match=f"to run its code, add --family {evil}:Family"):
            load(path)
    assert not (tmp_path / "ran").exists()


def test_a_family_that_is_named_again_has_to_be_the_same(exported):
    with pytest.raises(UsageError, match="was trained on family halfcheetah-vel, not hopper-vel"):
        load(exported, "hopper-vel")
    assert load(exported, "halfcheetah-vel").program.config == finished_config(engine="auto")


def test_what_cannot_be_read_or_is_another_programs_is_named(tmp_path):
    with pytest.raises(RunError, match=r"cannot read .*: Is a directory"):
        read_about(tmp_path)
    file = tmp_path / "a.safetensors"
    safetensors.write(file, {"a": np.zeros((2, 2), np.float32)}, {"format": "pt"})
    with pytest.raises(RunError, match="is not a policy file that this version of ear_jax can read"):
        read_about(file)
    header = safetensors.read_header(file)
    file.write_bytes(file.read_bytes()[:-4])  # meanwhile, by another process
    with pytest.raises(RunError, match=r"cannot read .*a\.safetensors: "):
        safetensors.read_arrays(file, header)
