"""Checkpoints: a saved state comes back to the bit, and a damaged one is found, named and passed over."""

from __future__ import annotations

import dataclasses
import errno
import hashlib
import os
import random
import shutil
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ear_jax.errors import RunError
from ear_jax.runs import checkpoint, manifest, records
from ear_jax.runs.loop import train_run
from ear_jax.runs.trained import load
from tests.helpers.faults import each_kill, killed_before
from tests.helpers.runs import finished_config, last_state, leaves, stray_writes

FIXTURES = Path(__file__).parents[1] / "fixtures"
FLIPS = 200
FIXTURE_CODES = [[0.5913335, 0.14441064, 0.7933916], [-0.41545773, -0.656422, -0.6296865]]


@pytest.fixture
def state() -> dict:
    return {
        "weights": jnp.arange(6.0).reshape(2, 3) / 7,
        "key": jax.random.split(jax.random.key(3), 2),
        "counts": (jnp.int32([1, 2]), {"done": jnp.array([True, False])}),
    }


@pytest.fixture
def steps(state, tmp_path) -> Path:
    for epoch in (2, 4):
        checkpoint.save(tmp_path / "checkpoints", epoch, state, {"engine": "native"})
    return tmp_path / "checkpoints"


def newest(directory: Path) -> tuple[int, list[str]]:
    warnings: list[str] = []
    return checkpoint.newest(directory, warnings.append).epoch, warnings


def test_what_is_saved_comes_back_to_the_bit(state, steps):
    step = checkpoint.newest(steps, pytest.fail)
    assert (step.epoch, step.about["engine"], step.about["epoch"]) == (4, "native", 4)
    back = checkpoint.restore(step, jax.eval_shape(lambda: state))
    assert jax.tree.structure(back) == jax.tree.structure(state)
    assert jax.tree.map(lambda leaf: leaf.dtype, back) == jax.tree.map(lambda leaf: leaf.dtype, state)
    for one, two in zip(leaves(back), leaves(state), strict=True):
        np.testing.assert_array_equal(one, two)


def test_a_part_is_read_without_the_rest(state, steps):
    part = {"weights": state["weights"], "key": None, "counts": (None, {"done": None})}
    back = checkpoint.restore(checkpoint.newest(steps, pytest.fail), part, partly=True)
    np.testing.assert_array_equal(back["weights"], state["weights"])
    assert back["key"] is None


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"weights": jnp.zeros((2, 4))}, r"weights is float32 \[2, 3\], not float32 \[2, 4\]"),
        ({"weights": jnp.zeros((2, 3), jnp.int32)}, r"weights is float32 \[2, 3\], not int32 \[2, 3\]"),
        ({"more": jnp.zeros(1)}, r"it has no more"),
        ({"counts": ()}, r"it has counts\.0, which is not expected"),
    ],
)
def test_the_first_difference_is_named(change, complaint, state, steps):
    with pytest.raises(RunError, match=complaint):
        checkpoint.restore(checkpoint.newest(steps, pytest.fail), {**state, **change})


def test_the_newest_two_and_the_first_past_every_doubling_are_kept(state, tmp_path):
    assert checkpoint.kept(range(50, 4001, 50)) == [50, 100, 150, 300, 550, 1050, 2050, 3950, 4000]
    small = {"key": state["key"]}
    for epoch in range(1, 8):
        checkpoint.save(tmp_path, epoch, small, {})
    assert checkpoint.steps(tmp_path) == [1, 2, 4, 6, 7]


def test_what_a_killed_process_left_goes_with_the_next_save(state, steps):
    (steps / ".6.part" / "state").mkdir(parents=True)
    assert newest(steps) == (4, [])
    checkpoint.save(steps, 6, state, {})
    assert sorted(path.name for path in steps.iterdir()) == ["2", "4", "6"]


def test_the_manifest_is_sha256sums(steps):
    if shutil.which("sha256sum") is None:
        pytest.skip("no sha256sum here")
    subprocess.run(["sha256sum", "--check", "--strict", "--quiet", manifest.NAME], cwd=steps / "4", check=True)


def test_every_flipped_bit_is_found(finished):
    """Bits are flipped anywhere in a real checkpoint: arrays, Orbax's own files, its description, the manifest."""
    step = finished / "checkpoints" / "24"
    files = sorted(path for path in step.rglob("*") if path.is_file())
    assert {"SHA256SUMS", "about.json"} <= {path.name for path in files}
    places = [(path, byte) for path in files for byte in range(path.stat().st_size)]
    dice = random.Random(0)
    for path, byte in (*dice.sample(places, FLIPS), *[(files[0], 0), (step / manifest.NAME, 70)]):
        content = path.read_bytes()
        flipped = bytearray(content)
        flipped[byte] ^= 1 << dice.randrange(8)
        path.write_bytes(flipped)
        assert manifest.fault(step) is not None, f"byte {byte} of {path}"
        path.write_bytes(content)
    assert manifest.fault(step) is None


@pytest.mark.parametrize("harm", ["truncated", "emptied", "deleted"])
def test_each_file_that_is_harmed_is_named_and_the_step_before_used(harm, finished):
    step = finished / "checkpoints" / "24"
    for path in sorted(path for path in step.rglob("*") if path.is_file()):
        content = path.read_bytes()
        if harm == "deleted":
            path.unlink()
        else:
            path.write_bytes(content[: len(content) // 2] if harm == "truncated" else b"")
        epoch, (warning,) = newest(finished / "checkpoints")
        assert epoch == 18
        assert f"{step} is damaged: " in warning
        assert warning.endswith("; going back to epoch 18")
        assert path.name in warning
        path.write_bytes(content)
    assert newest(finished / "checkpoints") == (24, [])


def test_a_run_whose_newest_checkpoint_is_damaged_ends_the_same(finished, capsys, compiled_once):
    before = last_state(finished, finished_config())
    (finished / "checkpoints" / "24" / "about.json").write_text("{}")
    train_run(finished_config(), finished)
    said = capsys.readouterr().err
    assert "about.json differs from its checksum; going back to epoch 18" in said
    for one, two in zip(leaves(before), leaves(last_state(finished, finished_config())), strict=True):
        np.testing.assert_array_equal(one, two)
    assert [row["epoch"] for row in records.read_rows(finished / "metrics.jsonl")][::2] == list(range(2, 25, 2))


@pytest.mark.parametrize("of", ["about.json", manifest.NAME])
def test_a_file_that_the_disk_cannot_read_is_named_and_the_step_before_used(of, steps, monkeypatch):
    """As at a bad sector: the file opens, and an error without its name follows."""
    bad, digest, read_text = str(steps / "4" / of), hashlib.file_digest, Path.read_text

    def check(name: object) -> None:
        if str(name) == bad:
            raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(hashlib, "file_digest", lambda file, kind: check(file.name) or digest(file, kind))
    monkeypatch.setattr(Path, "read_text", lambda path, **how: check(path) or read_text(path, **how))
    epoch, (warning,) = newest(steps)
    assert epoch == 2
    assert f"{of} cannot be read: Input/output error" in warning


def test_without_a_good_step_nothing_is_started_anew(steps):
    for epoch in ("2", "4"):
        (steps / epoch / "about.json").unlink()
    with pytest.raises(RunError, match=r"4 is damaged: about\.json is missing, and 1 older .* no good checkpoint"):
        newest(steps)


def test_links_and_strangers_in_a_step_are_refused_unread(steps, tmp_path):
    secret = tmp_path / "secret"
    secret.write_text("not yours")
    (steps / "4" / "state" / "more").symlink_to(secret)
    assert newest(steps)[1] == [
        f"warning: {steps / '4'} is damaged: state/more is not a regular file; going back to epoch 2"
    ]
    (steps / "4" / "state" / "more").unlink()
    (steps / "4" / "evil.pkl").write_bytes(b"cos\nsystem\n(S'true'\ntR.")
    assert "evil.pkl is not in its manifest" in newest(steps)[1][0]
    shutil.rmtree(steps / "4")
    (steps / "4").symlink_to(steps / "2")
    assert newest(steps) == (2, [])


@stray_writes
def test_killed_at_any_change_a_step_is_whole_or_absent(state, tmp_path):
    small = {"key": state["key"]}
    checkpoint.save(tmp_path, 2, small, {})

    def prepare() -> None:
        checkpoint.clean(tmp_path)
        shutil.rmtree(tmp_path / "4", ignore_errors=True)

    for _ in each_kill(prepare, lambda: checkpoint.save(tmp_path, 4, small, {}, "{}\n")):
        assert newest(tmp_path)[1] == []
    for change in (3, 9, 15):
        prepare()
        with killed_before(change):
            checkpoint.save(tmp_path, 4, small, {})
        checkpoint.save(tmp_path, 4, small, {})
        assert newest(tmp_path) == (4, [])
        assert sorted(path.name for path in tmp_path.iterdir()) == ["2", "4"]


def test_what_a_killed_save_left_is_removed_while_abandoned_writes_add_to_it(tmp_path, monkeypatch):
    rmtree, late = shutil.rmtree, ["state/d/1", "state/d/2", "state/3"]

    def with_late_writes(path: Path, ignore_errors: bool) -> None:
        rmtree(path)
        if late:
            records.write_text(path / late.pop(), "late")

    records.write_text(tmp_path / ".4.part" / "state" / "0", "early")
    monkeypatch.setattr(shutil, "rmtree", with_late_writes)
    checkpoint.clean(tmp_path)
    assert not any(tmp_path.iterdir())
    assert not late


@stray_writes
def test_a_save_that_fails_leaves_the_steps_before(state, steps, small_files):
    large = jax.random.normal(jax.random.key(0), 100_000)
    with small_files(4_000), pytest.raises(RunError, match=r"epoch 6 could not be written: .*File too large"):
        checkpoint.save(steps, 6, {**state, "large": large}, {})
    assert newest(steps) == (4, [])
    assert sorted(path.name for path in steps.iterdir()) == ["2", "4"]


def test_saved_on_two_devices_it_loads_on_one_and_back(finished, tmp_path):
    """The two devices are emulated, with a seed on each."""
    code = """
import sys; sys.path.insert(0, sys.argv[1])
from pathlib import Path
import jax
from tests.helpers.faults import each_kill, killed_before
from tests.helpers.runs import finished_config
from tests.helpers.runs import last_state
from ear_jax.runs import checkpoint
assert jax.device_count() == 2
state = last_state(Path(sys.argv[2]), finished_config())
across = jax.NamedSharding(jax.make_mesh((2,), ("seeds",)), jax.P("seeds"))
state = jax.device_put(state, across)
assert len(jax.tree.leaves(state.learner)[0].sharding.device_set) == 2
checkpoint.save(Path(sys.argv[3]) / "checkpoints", 24, state, {})
"""
    two = {**os.environ, "XLA_FLAGS": "--xla_force_host_platform_device_count=2", "JAX_PLATFORMS": "cpu"}
    arguments = [str(Path(__file__).parents[2]), str(finished), str(tmp_path / "two")]
    subprocess.run([sys.executable, "-c", code, *arguments], env=two, check=True, timeout=300)
    states = [last_state(run, finished_config()) for run in (finished, tmp_path / "two")]
    for one, other in zip(*map(leaves, states), strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_checkpoint_of_the_first_format_loads_and_its_run_goes_on(tmp_path, compiled_once):
    """It was written in November 2026 and never changed: a failure here means that users lose their runs."""
    directory = Path(shutil.copytree(FIXTURES / "format-1", tmp_path / "run"))
    trained = load(directory)
    codes = trained.program.agent.codes(jax.tree.map(lambda leaf: leaf[0], trained.policies))
    np.testing.assert_allclose(codes, FIXTURE_CODES, atol=1e-5)
    config = trained.program.config
    np.testing.assert_array_equal(last_state(directory, config).replay.added, [[60, 60]])
    train_run(dataclasses.replace(config, epochs=6), directory)
    assert [row["epoch"] for row in records.read_rows(directory / "metrics.jsonl")] == [2, 4, 6]


@pytest.mark.parametrize(
    ("about", "complaint"),
    [("[]", "about.json cannot be read: it is no table"), ('{"format": 1, "epoch": 4}', "does not list its arrays")],
)
def test_a_description_that_is_none_is_damage_also_with_its_checksum(about, complaint, steps):
    (steps / "4" / "about.json").write_text(about)
    manifest.write(steps / "4")
    epoch, (warning,) = newest(steps)
    assert epoch == 2
    assert complaint in warning


def test_a_format_from_the_future_is_refused(steps):
    path = steps / "4" / "about.json"
    records.write_json(path, {**records.read_json(path), "format": 99})
    manifest.write(steps / "4")
    with pytest.raises(RunError, match="has format 99, but this version of ear_jax reads 1"):
        newest(steps)
