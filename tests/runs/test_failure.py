"""Numbers that are not finite: in one environment they stay there, and in a loss they end the run with a report."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ear_jax.cli.main import main
from ear_jax.envs import FAMILIES
from ear_jax.envs.batched_env import is_finite
from ear_jax.errors import RunError
from ear_jax.learning import sac
from ear_jax.physics import Motion
from ear_jax.runs import on_host, records, training
from ear_jax.runs.loop import train_run
from ear_jax.runs.training import make_program
from tests.helpers.probe import Slider
from tests.helpers.runs import finished_config, last_state, leaves, tiny_config

STEPS = 15


class Breaking:
    """An engine whose speeds are not finite once the mass was past a limit."""

    def __init__(self, engine, limit: float):
        self.name, self._engine, self._limit = engine.name, engine, limit

    def step(self, physics, action) -> Motion:
        motion = self._engine.step(physics, action)
        broken = jnp.where(physics.qpos > self._limit, jnp.nan, motion.after.qvel)
        return motion.replace(after=motion.after.replace(qvel=broken))


class Poisoned(Slider):
    """A Slider; past `limit` the physics of that one environment breaks."""

    limit = 1e9

    def __init__(self, *arguments, **options):
        super().__init__(*arguments, **options)
        self.engine = Breaking(self.engine, self.limit)


def collected(limit: float, monkeypatch, state=None) -> tuple[training.TrainState, training.TrainState, float]:
    """Returns a run's state before and after an epoch of collection, and the number of steps counted as bad."""
    monkeypatch.setattr(Poisoned, "limit", limit)
    monkeypatch.setitem(FAMILIES, "probe", Poisoned)
    few = tiny_config().collect
    program = make_program(tiny_config(family="probe", tasks=("-0.5", "0.5"), collect=replace(few, steps=STEPS)))
    start = state or jax.jit(partial(training.init, program))(jax.random.key(1))
    after, metrics = jax.jit(partial(training.collect, program))(start)
    return start, after, float(metrics["invalid_steps"])


def transitions(state: training.TrainState, task: int) -> set[tuple[float, ...]]:
    """Returns the transitions in a task's ring, to the bit and in any order."""
    rings = jax.tree.map(lambda ring: np.asarray(ring[task, : state.replay.added[task]]), state.replay.rings)
    columns = [leaf.reshape(len(leaf), -1) for leaf in jax.tree.leaves(rings)]
    return set(map(tuple, np.concatenate(columns, axis=1).tolist()))


def test_one_bad_environment_of_one_task_leaves_the_others_to_the_bit(monkeypatch):
    start, sound, none = collected(1e9, monkeypatch)
    furthest = np.asarray(sound.replay.rings.obs[:, : 2 * STEPS, 0]).reshape(2, STEPS, 2).max(axis=1)  # [tasks, envs]
    task, env = np.unravel_index(furthest.argmax(), (2, 2))
    _, poisoned, bad = collected(np.sort(furthest.ravel())[-2:].mean(), monkeypatch, start)
    assert none == 0 < bad
    for one, two in zip(leaves(sound.cells), leaves(poisoned.cells), strict=True):
        same = (one == two).reshape(2, 2, -1).all(axis=-1)
        same[task, env] = True
        assert same.all()
    assert not np.array_equal(sound.cells.state.obs[task, env], poisoned.cells.state.obs[task, env]), "it was reset"
    assert transitions(sound, 1 - task) == transitions(poisoned, 1 - task)
    assert int(poisoned.replay.added[task]) == 2 * STEPS - bad, "its bad steps are in no ring"
    assert all(np.isfinite(leaf).all() for leaf in leaves(poisoned))


@pytest.mark.parametrize(
    ("numbers", "finite"),
    [
        ((1.0, [2.0, -3.0]), True),
        ((1.0, [2.0, jnp.nan]), False),
        ((1.0, [-jnp.inf]), False),
        ((1e9,), True),
        ((-2e10,), False),
    ],
)
def test_numbers_are_finite_and_of_a_sane_size(numbers, finite):
    assert bool(is_finite(jax.tree.map(jnp.asarray, numbers))) == finite


def test_mujocos_warnings_leave_no_file(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    family = Slider("native")
    state = family.reset(jax.random.key(0))
    bad = state.pipeline_state.replace(qvel=jnp.array([jnp.nan]))
    after = family.step(state.replace(pipeline_state=bad), jnp.zeros(1))
    assert not np.isfinite(after.pipeline_state.qvel).any()
    assert list(tmp_path.iterdir()) == []
    assert capfd.readouterr() == ("", "")


def test_a_loss_that_is_not_finite_ends_the_run_and_leaves_the_last_good_step(finished, monkeypatch):
    """The second task's targets are NaN from the first update after epoch 24."""
    before = leaves(last_state(finished, finished_config()))
    rows = records.read_rows(finished / "metrics.jsonl")
    target = sac.losses.critic_targets

    def poisoned(critic, predictions, batch, *arguments):
        return jnp.where(batch.task == 1, jnp.nan, target(critic, predictions, batch, *arguments))

    monkeypatch.setattr(sac.losses, "critic_targets", poisoned)
    compile_program, kept = on_host.compile_program, []

    def compile_once(*arguments):
        kept.extend([] if kept else [compile_program(*arguments)])
        return kept[0]

    monkeypatch.setattr(on_host, "compile_program", compile_once)
    for _ in range(2):  # the same command fails the same
        with pytest.raises(RunError, match=r"seed 0 failed: actor_loss is nan after 96 updates \(task vel-3\)"):
            train_run(finished_config(epochs=30), finished)
    report = json.loads((finished / "failure.json").read_text())
    assert (report["seed"], report["block_ends_at_epoch"], report["finite_updates"]) == (0, 26, 96)
    assert report["tasks"] == ["vel-3"]
    assert {"critic_loss", "critics_norm"} <= set(report["not_finite"])
    assert report["norms"]["critics_norm"] == "nan"
    assert report["last_finite_row"] == rows[-2]
    assert records.read_rows(finished / "metrics.jsonl") == rows
    for one, two in zip(before, leaves(last_state(finished, finished_config())), strict=True):
        np.testing.assert_array_equal(one, two)

    monkeypatch.undo()
    train_run(finished_config(epochs=26), finished)
    assert not (finished / "failure.json").exists()


def test_a_lost_run_is_exit_code_1_and_one_line(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr("ear_jax.runs.loop.train_run", _lost)
    assert main(["train", "halfcheetah-vel", "--out", str(tmp_path / "run")]) == 1
    assert capsys.readouterr().err == "ear: seed 0 is lost\n"


def _lost(config: object, directory: Path) -> None:
    raise RunError("seed 0 is lost")
