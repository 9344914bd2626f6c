"""Policies as ONNX: onnxruntime acts as JAX does, for every method; and model cards that hubs can read."""

from __future__ import annotations

import dataclasses
import json
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import yaml

from ear_jax import pretrained
from ear_jax.cli.main import main
from ear_jax.errors import RunError
from ear_jax.methods import METHODS, Sizes, make_agent
from ear_jax.presets import draft_config, preset_config
from ear_jax.rendering.live.programs import Constants, translate
from ear_jax.runs.model_card import to_markdown
from ear_jax.runs.onnx import run_onnx, to_onnx
from ear_jax.runs.trained import load, policy_of
from ear_jax.runs.training import make_program

ITEMS = 5


@pytest.mark.parametrize("method", METHODS)
def test_onnxruntime_acts_as_jax_does(method):
    pytest.importorskip("onnxruntime", reason="needs the extra onnx")
    config = draft_config("hopper-vel", "smoke", method)
    network = {**METHODS[method].presets.get("smoke", {}).get("network", {}), "width": 16, "task_width": 16}
    config = dataclasses.replace(config, network=dataclasses.replace(config.network, **network))
    history = config.network.history
    agent = make_agent(Sizes(4 * history, 2, 3), config)
    policy = agent.init_policy(jax.random.key(0))
    policy["standardiser"] = dataclasses.replace(policy["standardiser"], mean=jnp.arange(4.0 * history) / 9)

    acts_as_jax_does(agent, policy, 4 * history)


@pytest.mark.parametrize("method", ["ear", "multihead", "onehot"])
def test_onnxruntime_turns_with_the_robot_as_jax_does(method):
    pytest.importorskip("onnxruntime", reason="needs the extra onnx")
    config = preset_config("ant-dir", "fast+equivariant", method)
    agent = make_program(dataclasses.replace(config, network=dataclasses.replace(config.network, width=16))).agent
    acts_as_jax_does(agent, agent.init_policy(jax.random.key(0)), 27)


def acts_as_jax_does(agent, policy, obs_size):
    def act(lte, obs):
        distribution = agent.distribution(policy, lte, obs)
        return jnp.tanh(distribution.mean), distribution.mean, distribution.log_std

    constants, random = Constants(), np.random.default_rng(0)
    program = translate(act, constants, jnp.zeros(agent.code_size), jnp.zeros(obs_size))
    model = to_onnx(program, np.concatenate(constants.arrays), {})
    lte = random.normal(size=(ITEMS, agent.code_size)).astype(np.float32)
    obs = 2 * random.normal(size=(ITEMS, obs_size)).astype(np.float32)
    expected = jax.vmap(act)(jnp.asarray(lte), jnp.asarray(obs))
    for one, other in zip(run_onnx(model, lte, obs), expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-4, atol=2e-5)
    for one, other in zip(run_onnx(model, lte[:1], obs[:1]), expected, strict=True):
        np.testing.assert_allclose(one, other[:1], rtol=1e-4, atol=2e-5)


def test_an_agent_that_ships_is_exported_and_runs_without_ear_jax(tmp_path, capsys):
    onnxruntime = pytest.importorskip("onnxruntime", reason="needs the extra onnx")
    file = tmp_path / "hub" / "policy.onnx"
    assert main(["export", "pretrained:hopper-vel", str(file), "--card", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["largest_difference"] < 1e-4
    assert document["bytes"] == file.stat().st_size
    session = onnxruntime.InferenceSession(file)
    ltes = json.loads(session.get_modelmeta().custom_metadata_map["ltes"])
    obs = np.linspace(-1, 1, 11, dtype=np.float32)[None]
    (action,) = session.run(["action"], {"lte": np.array([ltes["vel-1.4"]], np.float32), "obs": obs})
    trained = load(Path("pretrained:hopper-vel"))
    agent, policy = trained.program.agent, policy_of(trained, 0)
    code = agent.codes(policy)[trained.program.tasks.index("vel-1.4")]
    np.testing.assert_allclose(action[0], jnp.tanh(agent.distribution(policy, code, obs[0]).mean), atol=1e-4)
    block = (file.parent / "README.md").read_text().split("```python\n")[1].split("```")[0]
    names: dict = {}
    exec(block.replace('"policy.onnx"', repr(str(file))), names)
    assert names["action"].shape == (1, 3)


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["policy.tflite"], "policy.tflite must end in .safetensors or .onnx"),
        (["README.safetensors", "--card"], "README.md already exists"),
        (["two.safetensors", "--policy", "2"], "--policy 2 is out of range"),
    ],
)
def test_mistakes_are_one_line_and_write_nothing(words, complaint, finished, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    if "--card" in words:
        Path("README.md").touch()
    assert main(["export", str(finished), *words]) == 2
    assert complaint in capsys.readouterr().err
    assert not Path(words[0]).exists()


def test_several_policies_need_a_choice_for_a_card(finished, tmp_path, capsys):
    file = tmp_path / "hub" / "policy.safetensors"
    assert main(["export", str(finished), str(file), "--card"]) == 2
    assert "has 2 policies; choose one with --policy 0 to 1" in capsys.readouterr().err
    assert main(["export", str(finished), str(file), "--card", "--policy", "1"]) == 0
    text = (file.parent / "README.md").read_text()
    assert "seed 1" in text
    assert "which tasks it meets is not known" in text
    assert "license" not in front_matter(text)


def test_onnx_that_is_absent_is_one_line_before_anything_is_loaded(monkeypatch, tmp_path, capsys):
    monkeypatch.setitem(sys.modules, "onnx", None)
    assert main(["export", "pretrained:hopper-vel", str(tmp_path / "policy.onnx")]) == 1
    assert capsys.readouterr().err == "ear: ONNX needs packages that are not installed: pip install 'ear-jax[onnx]'\n"


def test_an_operation_that_onnx_lacks_is_named():
    pytest.importorskip("onnxruntime", reason="needs the extra onnx")
    program = translate(jnp.arctan2, constants := Constants(), jnp.zeros(2), jnp.zeros(2))
    with pytest.raises(RunError, match="cannot be written as ONNX: it uses JAX's operation 'atan2'"):
        to_onnx(program, np.concatenate([np.zeros(0, np.float32), *constants.arrays]), {})


def test_a_file_that_would_act_otherwise_is_not_written(tmp_path, monkeypatch, capsys):
    pytest.importorskip("onnxruntime", reason="needs the extra onnx")
    monkeypatch.setattr("ear_jax.runs.onnx.run_onnx", lambda model, ltes, obs: [np.full((len(obs), 3), 2.0)])
    file = tmp_path / "policy.onnx"
    assert main(["export", "pretrained:hopper-vel", str(file)]) == 1
    assert "is not written: actions of onnxruntime and JAX differ by" in capsys.readouterr().err
    assert not file.exists()


def front_matter(text: str) -> dict:
    return yaml.safe_load(text.split("---\n")[1])


@pytest.mark.parametrize("name", pretrained.names())
def test_model_cards_have_the_front_matter_of_hubs(name):
    card = pretrained.card(name)
    text = to_markdown(card, "policy.safetensors")
    front = front_matter(text)
    assert (front["license"], front["library_name"]) == ("mit", "ear-jax")
    assert front["pipeline_tag"] == "reinforcement-learning"
    (model,) = front["model-index"]
    (result,) = model["results"]
    assert (model["name"], result["dataset"]["type"]) == (name, card["family"])
    mean, spread = map(float, result["metrics"][0]["value"].split(" +/- "))
    assert mean == pytest.approx(card["mean_return"], abs=0.01)
    assert spread == pytest.approx(np.std([task["return"] for task in card["tasks"]]), abs=0.01)
    for task in card["tasks"]:
        assert f"| {task['name']} |" in text
    assert card["limits"] in text.replace("\\", ""), "but for marks that Markdown would read"
