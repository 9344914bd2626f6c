"""The command line as a user meets it: one line for a mistake, one document for `--json`."""

from __future__ import annotations

import dataclasses
import json
import math
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from ear_jax.cli.doctor import known_bad, lacking
from ear_jax.cli.main import main
from ear_jax.cli.train import read
from ear_jax.methods import METHODS
from ear_jax.presets import preset_config
from ear_jax.runs.directory import default_directory
from ear_jax.runs.records import versions

TINY = [
    "--engine",
    "native",
    "--tasks",
    "1",
    "3",
    "--epochs",
    "2",
    "--network.width",
    "16",
    "--sac.batch-size",
    "32",
    "--sac.updates",
    "4",
    "--collect.envs",
    "2",
    "--collect.steps",
    "5",
    "--collect.pretrain-epochs",
    "2",
    "--replay.capacity",
    "400",
    "--log.epochs",
    "2",
    "--log.episodes",
    "1",
]


def ear(*words: str, cwd: Path, **variables: str) -> subprocess.CompletedProcess[str]:
    """Runs the installed command in a process of its own."""
    command = [sys.executable, "-m", "ear_jax.cli.main", *words]
    environment = {**os.environ, "EAR_JAX_CACHE": str(cwd / "cache"), **variables}
    return subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, timeout=900)


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        ("trian", "did you mean 'train'"),
        ("train", "name a family first"),
        ("train halfcheeta-vel", "did you mean 'halfcheetah-vel'"),
        ("train halfcheetah-vel --preset fats", "did you mean 'fast'"),
        ("train halfcheetah-vel --preset fast+no-nose", "did you mean 'no-noise'"),
        ("train halfcheetah-vel --preset fast+no-norm --agent onehot", "has no use for --network.normalise-lse"),
        ("train halfcheetah-vel --sac.lrr 1", "did you mean --sac.lr?"),
        ("train halfcheetah-vel --sac.lr abc", "--sac.lr takes a number, not 'abc'"),
        ("train halfcheetah-vel --sac.lr -1", "must be above 0"),
        ("train halfcheetah-vel --sac.pessimism 2", "it must be from 0 to 1"),
        ("train halfcheetah-vel --seeds 0", "--seeds 0 is too small; it must be at least 1"),
        (
            "train halfcheetah-vel --seed 3000000000",
            "the last seed must be below 2147483648",
        ),
        ("adapt full --seed -1", "--seed -1 is out of range; it must be from 0 to 2147483647"),
        ("train halfcheetah-vel --collect.envs -3", "must be at least 1"),
        ("train halfcheetah-vel --sac.batch-size 481", "try 480 or 490"),
        ("train halfcheetah-vel --agent eer", "did you mean 'ear'"),
        ("train halfcheetah-vel --agent pearl --sac.return-scale 9", "--sac.return-scale does not go with pearl"),
        ("train halfcheetah-vel --agent ear-rnn --network.encoder-layers 0", "0 is too small for ear-rnn"),
        ("train halfcheetah-vel --agent maml --sac.updates 2", "--sac.updates 2 is too many; maml makes one"),
        ("train halfcheetah-vel --engine mjxx", "did you mean 'mjx'"),
        ("train halfcheetah-vel --tasks 1 fast", "name a speed in metres per second"),
        ("train halfcheetah-vel --tasks 2 vel-2", "'vel-2' is given twice"),
        ("train halfcheetah-vel --replay.capacity 100", "it must be at least 2000"),
        ("interpolate run --between 1 2 --beta 0.5 nan", "--beta 0.5 nan is out of range; it must be finite"),
        ("interpolate run --between 1 2 --target inf", "--target inf is out of range; it must be finite"),
        ("compose run --between 1 2 --beta nan", "--beta nan is out of range; it must be finite"),
        ("adapt run --sigma inf", "--sigma inf is out of range; it must be finite"),
        ("train halfcheetah-vel --out afile", "afile is a file"),
        ("train halfcheetah-vel --out afile/run", "afile is a file"),
        ("train halfcheetah-vel --out full", "neither empty nor a run directory"),
        ("evaluate nowhere", "not a run directory"),
        ("evaluate", "RUN is missing: the run directory, an exported file, or pretrained:NAME"),
        ("evaluate full --episodes 0", "must be at least 1"),
    ],
)
def test_a_mistake_gets_one_clear_line_and_exit_code_2(words, complaint, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("afile").touch()
    Path("full").mkdir()
    Path("full/something").touch()
    assert main(words.split()) == 2
    streams = capsys.readouterr()
    assert complaint in streams.err
    assert streams.err.startswith("ear: ")
    assert streams.err.count("\n") == 1
    assert streams.out == ""
    assert not Path("runs").exists()


def test_too_large_a_replay_is_refused_with_the_sizes(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["train", "halfcheetah-vel", "--replay.capacity", "2147483647"]) == 1
    assert re.fullmatch(
        r"ear: this run needs [\d.]+ GB of memory \(replay [\d.]+ GB, .*, compiling [\d.]+ GB, saving [\d.]+ GB\), "
        r"but only [\d.]+ GB is free under .*; lower .*\n",
        capsys.readouterr().err,
    )
    assert not Path("runs").exists()


def test_what_the_disk_refuses_is_one_line_and_exit_code_1(monkeypatch, capsys):
    def refuse(words):
        raise PermissionError(13, "Permission denied", "figures/map.png")

    monkeypatch.setattr("ear_jax.cli.doctor.main", refuse)
    assert main(["doctor"]) == 1
    assert capsys.readouterr().err == "ear: figures/map.png: Permission denied\n"


def test_a_directory_that_cannot_be_made_is_exit_code_1(capsys):
    """Not even root can make a directory in /proc."""
    assert main(["train", "halfcheetah-vel", "--out", "/proc/run"]) == 1
    assert capsys.readouterr().err.startswith("ear: cannot ")


def test_an_engine_that_cannot_run_here_is_exit_code_1(tmp_path, monkeypatch, capsys):
    import jax

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    assert main(["evaluate", "pretrained:halfcheetah-vel", "--engine", "native"]) == 1
    assert "use 'mjx'" in capsys.readouterr().err


def test_what_is_made_on_an_accelerator_names_it(monkeypatch):
    import jax

    from ear_jax.runs import records

    assert "accelerator" not in records.provenance()["machine"]
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    assert records.provenance()["machine"]["accelerator"] == jax.local_devices()[0].device_kind


def test_settings_override_the_preset():
    config = read(
        ["halfcheetah-vel", "--preset", "smoke", "--sac.lr", "1e-4", "--replay.share-experience", "false"]
    ).config
    assert (config.preset, config.sac.lr, config.replay.share_experience) == ("smoke", 1e-4, False)
    assert config.tasks == ("1", "2", "3")
    assert config.sac.batch_size == 240


def test_a_preset_goes_on_with_variants():
    config = read(["ant-dir", "--preset", "paper+no-noise+no-norm"]).config
    assert (config.preset, config.sac.batch_size, config.sac.lte_noise) == ("paper+no-noise+no-norm", 1920, 0.0)
    assert (config.network.normalise_lse, config.network.normalise_lte) == (False, False)
    config = read(["ant-dir", "--preset=fast+task-hidden", "--network.task-width", "64"]).config
    assert (config.network.task_layers, config.network.task_width, config.sac.lte_noise) == (1, 64, 0.02)
    assert default_directory(config) == Path("runs/ant-dir-ear-fast+task-hidden-seed0")
    config = read(["ant-dir", "--agent=onehot", "--preset=fast+wide"]).config
    assert (config.network.width, config.network.matmul, config.network.critic_layers) == (512, "bfloat16", 2)


def test_multihead_has_its_own_depth_and_clip_under_paper():
    config = read(["halfcheetah-vel", "--preset", "paper", "--agent", "multihead"]).config
    assert (config.network.decoder_layers, config.network.critic_layers, config.sac.max_grad_norm) == (3, 3, 1.0)
    fast, multihead = (read(["halfcheetah-vel", "--agent", agent]).config for agent in ("ear", "multihead"))
    assert multihead == dataclasses.replace(fast, agent="multihead")


OFF_POLICY = [name for name, method in METHODS.items() if not method.learner.on_policy]


@pytest.mark.parametrize("agent", OFF_POLICY)  # on-policy steps are bounded by a trust region
def test_the_step_size_of_fast_falls_over_all_of_its_updates(agent):
    for family in ("halfcheetah-vel", "ant-dir", "hopper-vel"):
        config = preset_config(family, "fast", agent)
        assert config.sac.lr_decay == config.epochs * config.sac.updates


def test_paper_preset_is_the_papers():
    config = read(["halfcheetah-vel", "--preset", "paper"]).config
    assert (config.network.width, config.sac.batch_size, config.sac.lr, config.epochs) == (400, 1280, 3e-4, 4000)
    assert (config.network.encoder_layers, config.network.decoder_layers, config.network.critic_layers) == (2, 4, 4)
    assert (config.sac.discount, config.sac.tau, config.sac.lte_noise) == (0.99, 0.005, 0.02)
    assert config.collect.envs * config.collect.steps == config.sac.updates == 200
    assert (config.replay.capacity, config.collect.pretrain_epochs) == (1_000_000, 20)


# To save time: ear trains in many tests, one-hots, heads and RNNs add no state of their own, MAML compiles for long.
SLOWLY = {"ear", "ear-rnn", "onehot", "onehot-blind", "multihead", "maml"}


@pytest.mark.parametrize("agent", [pytest.param(one, marks=[pytest.mark.slow] * (one in SLOWLY)) for one in METHODS])
def test_every_agent_trains(agent, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    words = [*TINY, "--agent", agent, "--out", "run"]
    if METHODS[agent].learner.on_policy:  # which reads neither a batch size nor a replay
        words += ["--collect.steps", "6", "--sac.updates", "1"]
        for name in ("--sac.batch-size", "--replay.capacity"):
            del words[words.index(name) : words.index(name) + 2]
    assert main(["train", "halfcheetah-vel", *words]) == 0
    rows = [json.loads(line) for line in Path("run/metrics.jsonl").read_text().splitlines()]
    assert rows[-1]["epoch"] == 2
    assert all(math.isfinite(rows[-1][name]) for name in ("mean_return", "policy_norm"))
    if agent in ("pearl", "maml"):
        assert main(["adapt", "run", "--elites", "3"]) == 2
        assert f"set up the cross-entropy method, which {agent} does not use" in capsys.readouterr().err


def test_train_then_evaluate_prints_one_json_document(tmp_path, monkeypatch, capsys):
    trained = ear("train", "halfcheetah-vel", *TINY, "--seeds", "2", "--out", "run", cwd=tmp_path, XLA_FLAGS="")
    assert (trained.returncode, trained.stdout) == (0, ""), trained.stderr
    assert "epoch 2/2" in trained.stderr
    assert "curves: run/figures/training.png" in trained.stderr
    assert (tmp_path / "run" / "figures" / "training.png").stat().st_size > 5_000
    done = ear("evaluate", "run", "--episodes", "2", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    assert (document["env_steps"], document["updates"], document["episodes"]) == (80, 8, 2)
    assert [seed["seed"] for seed in document["seeds"]] == [0, 1]
    task = document["seeds"][1]["tasks"][1]
    assert (task["name"], task["target"], len(task["episodes"]["velocity"])) == ("vel-3", 3.0, 2)
    assert set(task["outcome"]) == {"velocity", "squared_action"}
    monkeypatch.chdir(tmp_path)
    documents = []
    for seed in ([], [], ["--seed", "5"]):
        assert main(["evaluate", "run", "--episodes", "2", "--json", *seed]) == 0
        documents.append(capsys.readouterr().out)
    assert documents[0] == documents[1] != documents[2]
    assert not (tmp_path / "MUJOCO_LOG.TXT").exists()


def test_doctor_is_content_here_and_prints_json(tmp_path):
    done = ear("doctor", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    assert document["problems"] == []
    assert document["engine"] == "native"


def test_doctor_knows_bad_mixes():
    good = versions()
    assert known_bad(good, (3, 11)) == []
    assert "do not match" in known_bad({**good, "mujoco": "4.0.0"}, (3, 11))[0]
    assert "not supported" in known_bad(good, (3, 10))[0]
    assert "untested" in known_bad({**good, "jax": "0.9.1", "jaxlib": "0.9.1"}, (3, 11))[0]
    assert "not installed" in known_bad({**good, "brax": None}, (3, 11))[0]


def test_doctor_tells_what_is_lacking_and_what_goes_without_it(monkeypatch):
    monkeypatch.setattr("shutil.which", lambda name: f"/usr/bin/{name}")
    monkeypatch.setattr("ctypes.util.find_library", lambda name: name)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: name)
    assert lacking() == []
    for place in ("shutil.which", "ctypes.util.find_library", "importlib.util.find_spec"):
        monkeypatch.setattr(place, lambda name: None)
    ffmpeg, opengl, metaworld = lacking()
    assert ffmpeg == "ffmpeg is not on the PATH, so `ear render` makes GIFs and no MP4s"
    assert "install libegl1 or libosmesa6" in opengl
    assert "pip install 'ear-jax[reach]'" in metaworld


def test_importing_prints_nothing(tmp_path):
    code = "import ear_jax, ear_jax.runs.loop, ear_jax.embeddings.evaluate, ear_jax.cli.main, ear_jax.physics.mjx"
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("", "")
    assert list(tmp_path.iterdir()) == []
