"""Settings as files: what is printed is what is read, flags go over a file, and mistakes are one line."""

from __future__ import annotations

import dataclasses
import json
import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest

from ear_jax.cli.completion import commands
from ear_jax.cli.main import COMMANDS, main
from ear_jax.cli.train import read
from ear_jax.config import Config
from ear_jax.config_files import read_settings, to_toml, with_settings
from ear_jax.errors import UsageError
from ear_jax.names import METHODS
from ear_jax.presets import PRESETS, draft_config


@pytest.fixture(autouse=True)
def _here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("preset", [*PRESETS, "fast+wide+no-norm"])
@pytest.mark.parametrize("agent", METHODS)
def test_a_file_gives_the_settings_that_were_printed(preset, agent):
    config = dataclasses.replace(draft_config("ant-dir", preset, agent), tasks=("0", 'a "b"\\ñ'), minutes=1e-7, seed=3)
    Path("settings.toml").write_text(to_toml(config), encoding="utf-8")
    assert with_settings(Config("hopper-vel"), read_settings(Path("settings.toml"))) == config


def test_a_command_line_comes_back_from_its_file_and_flags_go_over_it(capsys):
    words = ["halfcheetah-vel", "--preset", "smoke", "--sac.lr", "1e-4", "--replay.share-experience", "false"]
    taken = Path("runs/halfcheetah-vel-ear-smoke-seed0/mine.txt")  # where `ear train` would refuse to write
    taken.parent.mkdir(parents=True)
    taken.touch()
    assert main(["config", *words]) == 0
    Path("mine.toml").write_text(capsys.readouterr().out)
    assert read(["--config", "mine.toml"]).config == read(words).config
    with pytest.raises(UsageError, match="has tasks of halfcheetah-vel; name those of ant-dir with --tasks"):
        read(["ant-dir", "--config", "mine.toml"])
    over = read(["ant-dir", "--config=mine.toml", "--sac.lr", "1e-3", "--seed", "7", "--tasks", "0", "90"]).config
    assert (over.family, over.sac.lr, over.seed, over.preset) == ("ant-dir", 1e-3, 7, "smoke")
    assert not over.replay.share_experience
    assert main(["config", "--config", "mine.toml", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == json.loads(json.dumps(dataclasses.asdict(read(words).config)))


def test_a_part_of_the_settings_goes_over_the_preset_it_names():
    Path("part.toml").write_text('family = "hopper-vel"\nagent = "onehot"\n[sac]\nlr = 0.5\n')
    config = read(["--config", "part.toml", "--preset", "paper"]).config
    assert (config.family, config.agent, config.preset, config.sac.lr) == ("hopper-vel", "onehot", "paper", 0.5)
    assert (config.network.width, config.epochs) == (400, 5000)


def test_a_setting_of_earlier_versions_that_changed_no_result_is_passed_over(finished):
    settings = json.loads((finished / "config.json").read_text())
    settings["config"]["network"]["kernels"] = "fused"
    Path("earlier.json").write_text(json.dumps(settings))
    assert read(["--config", "earlier.json"]).config == read(["--config", str(finished)]).config


def test_a_runs_settings_are_a_file(finished):
    config = read(["--config", str(finished / "config.json"), "--seed", "8"]).config
    assert (config.seed, config.network.width, config.tasks) == (8, 16, ("1", "3"))
    assert read(["--config", str(finished), "--seed", "8"]).config == config


def test_a_flipped_bit_in_a_runs_settings_is_found(finished, capsys):
    file = finished / "config.json"
    file.write_text(file.read_text().replace('"width": 16', '"width": 17'))
    assert main(["train", "--config", str(finished)]) == 1
    assert "config.json is damaged: it differs from its checksum" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "words", "complaint"),
    [
        (None, [], "no file mine.toml; `ear config FAMILY` prints one"),
        ("sac = [", [], "mine.toml is not TOML"),
        ("[sac]\nlrr = 1", [], "mine.toml: unknown setting 'sac.lrr'; did you mean 'sac.lr'?"),
        ('[sac]\nlr = "much"', [], "mine.toml: the setting sac.lr is 'much'; it must be of type float"),
        ("seeds = true", [], "mine.toml: the setting seeds is True; it must be of type int"),
        ("sac = 1", [], "mine.toml: sac must be a table of settings"),
        ("seed = 1", [], "name a family first"),
        ('family = "hoper-vel"', [], "did you mean 'hopper-vel'?"),
        ('family = "hopper-vel"\nseeds = 0', [], "--seeds 0 is too small"),
        ('family = "hopper-vel"\npreset = "smoke"', ["--preset", "fast"], "--preset fast does not go with mine.toml"),
    ],
)
def test_mistakes_in_a_file_are_one_line(text, words, complaint, capsys):
    if text is not None:
        Path("mine.toml").write_text(text)
    assert main(["train", "--config", "mine.toml", *words]) == 2
    error = capsys.readouterr().err
    assert complaint in error
    assert error.count("\n") == 1
    assert not Path("runs").exists()


def test_a_file_that_cannot_be_read_is_one_line(capsys):
    Path("folder.toml/config.json").mkdir(parents=True)
    Path("mine.toml").write_bytes(b"\xff\x00")
    for file, reason in (("folder.toml", "Is a directory"), ("mine.toml", "it is not text")):
        assert main(["train", "--config", file]) == 1
        error = capsys.readouterr().err
        assert error.endswith(f"cannot be read: {reason}\n")
        assert error.count("\n") == 1


def test_settings_that_are_none_stay_visible():
    text = to_toml(Config("hopper-vel"))
    assert "# minutes =" in text
    assert "minutes" not in tomllib.loads(text)


def test_every_command_with_options_is_completed():
    assert set(COMMANDS) - set(commands()) == {"config"}  # whose options are those of train


@pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")
def test_bash_completes_commands_and_flags(capsys):
    assert main(["completion", "bash"]) == 0
    Path("ear.bash").write_text(capsys.readouterr().out)
    asked = "; ".join(
        f"COMP_WORDS=(ear {words}); COMP_CWORD={len(words.split())}; COMPREPLY=(); _tyro_ear; echo ${{COMPREPLY[@]}}"
        for words in ("comp", "plot --me", "train --sac.lr-")
    )
    done = subprocess.run(["bash", "-c", f"source ear.bash; {asked}"], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == ["compare completion compose", "--metric", "--sac.lr-decay"]
