"""`ear refine RUN FILE` on a small run."""

from __future__ import annotations

import json

import pytest

from ear_jax.cli.main import main
from ear_jax.cli.refine import RefineCommand
from ear_jax.learning.ppo import Ppo
from ear_jax.runs.refine import Refinement
from ear_jax.runs.trained import describe, load, pick

QUICK = ("--iterations", "1", "--iteration-episodes", "1", "--episodes", "1")


def test_a_refined_policy_is_a_file_that_tells_of_it_and_can_be_played(finished, tmp_path, capsys):
    file = tmp_path / "refined.safetensors"
    assert main(["refine", str(finished), str(file), *QUICK, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    refined, before = load(file), load(finished)
    assert refined.about["refined"]["from"] == before.fingerprint
    assert refined.env_steps == before.env_steps + document["env_steps"]
    for index, entry in enumerate(document["seeds"]):
        means = entry["before"], entry["after"]
        assert "mean return {:.1f} before, {:.1f} after".format(*means) in describe(pick(refined, index), [])
    assert (tmp_path / "refined-results" / "refinement.json").is_file()
    assert not (tmp_path / "refined.part").exists()
    assert len(document["figures"]) == len(document["seeds"])
    assert main(["refine", str(finished), str(file), *QUICK]) == 2
    assert f"{file} already exists; name another file" in capsys.readouterr().err


def test_options_that_the_family_does_not_have_or_that_are_out_of_range_are_refused(finished, tmp_path, capsys):
    file = str(tmp_path / "refined.safetensors")
    assert main(["refine", str(finished), file, *QUICK, "--env.lateral-weight", "1"]) == 2
    assert "has no setting 'lateral_weight'" in capsys.readouterr().err
    assert main(["refine", "pretrained:ant-dir", file, *QUICK, "--env.lateral-weight", "nan"]) == 2
    assert "--env.lateral-weight nan is out of range; it must be finite" in capsys.readouterr().err


def test_defaults_are_those_of_the_algorithm():
    assert RefineCommand.iterations == Refinement().iterations
    assert RefineCommand.iteration_episodes == Ppo.episodes
    for name in ("divergence", "noise", "least_noise"):
        assert getattr(RefineCommand, name) == getattr(Ppo, name)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["refined.onnx"], "refined.onnx must end in .safetensors"),
        (["refined.safetensors", "--divergence", "0"], "--divergence 0 is too small; it must be above 0"),
        (["refined.safetensors", "--noise", "-1"], "--noise -1 is too small; it must be at least 0"),
        (["refined.safetensors", "--least-noise", "0"], "--least-noise 0 is too small; it must be above 0"),
        (["refined.safetensors", "--iteration-episodes", "0"], "--iteration-episodes 0 is too small"),
        (["refined.safetensors", "--noise", "nan"], "--noise"),
        (["nowhere/on/earth.safetensors", "--iterations", "0"], "--iterations 0 is too small"),
    ],
)
def test_what_cannot_be_is_refused_before_anything_is_loaded(words, said, capsys):
    assert main(["refine", "pretrained:hopper-vel", *words]) == 2
    assert said in capsys.readouterr().err
