"""Refining by PPO, for an agent whose action is at first the first number of its code."""

from __future__ import annotations

import copy
import math
from dataclasses import replace

import jax
import numpy as np
import pytest

from ear_jax.errors import RunError, UsageError
from ear_jax.files.replacing import claim_file
from ear_jax.learning.ppo import Ppo
from ear_jax.process.stopping import Stopped
from ear_jax.runs import refine as refining
from ear_jax.runs import safetensors, training
from ear_jax.runs.refine import Refinement, refine
from ear_jax.runs.trained import policy_of
from tests.helpers.documented import check_keys
from tests.helpers.teachable import on_clock

SMALL = Refinement(12, Ppo(episodes=4, batch=40))


@pytest.fixture(scope="module")
def toy():
    return on_clock(seeds=2)


@pytest.fixture(scope="module")
def whole(toy):
    """Returns what a refinement gives that is not stopped."""
    return refine(toy, SMALL, 1, 3)


@pytest.fixture
def stops(monkeypatch):
    """Asks refinements to stop after their first iteration, unless `signal` is None."""

    class Request:
        signal = 2

        def __init__(self, *_):
            pass

        def __enter__(self):
            return self

        def __exit__(self, *_):
            pass

    monkeypatch.setattr(refining, "StopRequest", Request)
    return Request


def test_only_the_value_learns_at_first():
    assert [number for number in range(300) if not Refinement(300).divergence(number)] == list(range(10))
    assert [number for number in range(40) if not Refinement(40).divergence(number)] == list(range(4))
    assert Refinement(1).divergence(0) > 0


def test_a_policy_learns_what_returns_more_and_keeps_its_ltes(toy):
    """Under its own code the first task's action is right for 4 steps of 20 and off by 1 for 16."""
    refined, document = refine(toy, Refinement(60, Ppo(16, divergence=0.3, lr=1e-3, least_noise=0.3)), episodes=1)
    for index, seed in enumerate(document["seeds"]):
        assert seed["before"] == pytest.approx(-16, abs=1e-3)
        assert seed["after"] > -8
        assert len(seed["course"]) == 60
        now, before = policy_of(refined, index), policy_of(toy, index)
        np.testing.assert_array_equal(toy.program.agent.codes(now), toy.program.agent.codes(before))
    assert document["env_steps"] == refined.about["refined"]["env_steps"] == 60 * 2 * 8 * 20
    assert document["updates"] == 60 * 3


def test_one_that_was_stopped_continues_bit_by_bit(toy, whole, tmp_path, stops, capsys):
    part = tmp_path / "refined.part"
    for iteration in (1, 2):
        with pytest.raises(Stopped):
            refine(toy, SMALL, 1, 3, part)
        assert f"stopped at iteration {iteration}; the same command continues" in capsys.readouterr().err
    stops.signal = None
    continued, ends = refine(toy, SMALL, 1, 3, part)
    assert continued.fingerprint == whole[0].fingerprint != toy.fingerprint
    assert {**ends, "seconds": 0} == {**whole[1], "seconds": 0}


def test_one_file_has_one_writer(tmp_path):
    complaint = r"another process writes .*a\.part; wait for it, or name another file"
    with claim_file(tmp_path / "a.part"), pytest.raises(RunError, match=complaint), claim_file(tmp_path / "a.part"):
        pass
    assert list(tmp_path.iterdir()) == []


def test_what_was_kept_of_another_refinement_or_is_damaged_is_refused(toy, tmp_path, stops):
    part = tmp_path / "refined.part"
    with pytest.raises(Stopped):
        refine(toy, SMALL, 1, part=part)
    with pytest.raises(
        UsageError, match=r"another refinement \(seed was 0, is 1\); give the same settings, or name another file"
    ):
        refine(toy, SMALL, 1, seed=1, part=part)
    content = part.read_bytes()
    arrays, metadata = {"x": np.zeros(1, np.float32)}, {}
    safetensors.write(part, arrays, {"sha256": safetensors.digest(arrays, metadata)})
    with pytest.raises(RunError, match="holds no refinement of this version; delete it to begin anew"):
        refine(toy, SMALL, 1, part=part)
    for damaged in (content[:-1] + bytes([content[-1] ^ 1]), content[:100]):
        part.write_bytes(damaged)
        with pytest.raises(RunError, match="delete it to begin anew"):
            refine(toy, SMALL, 1, part=part)


def test_what_is_kept_of_many_iterations_can_be_read(toy, tmp_path):
    """Their returns alone would fill the metadata that a file may have."""
    learner = refining.PpoLearner(toy.program.agent, toy.program.family, toy.program.tasks.params, SMALL.ppo)
    state = jax.vmap(learner.init)(toy.policies, jax.random.split(jax.random.key(0), 2))
    curve = refining.Curve([[0.0, 1.0]] * 2, 40_000, 1.5, tuple([0.5 + number, -0.1] for number in range(40_000)))
    part = tmp_path / "refined.part"
    refining._write(part, {}, state, curve)
    read = refining._read(part, state, {})[1]
    assert (read.before, read.iteration, read.seconds) == (curve.before, curve.iteration, curve.seconds)
    np.testing.assert_allclose(read.returns, curve.returns, rtol=1e-6)


def test_costs_of_refinements_add_up(toy):
    quick = Refinement(1, Ppo(episodes=2))
    one, document = refine(toy, quick, 1)
    again = refine(one, quick, 1)[0].about["refined"]
    assert again["env_steps"] == 2 * document["env_steps"]
    assert (again["iterations"], again["from"]) == (2, one.fingerprint)


def test_it_learns_under_other_options_and_tells_returns_under_the_runs(toy, whole, monkeypatch):
    """The rewards that it learns from are one lower, so each of an episode's 20 steps loses one."""

    def family_with(program, options):
        assert options == {"toll": 1.0}
        family = copy.copy(program.family)
        vars(family)["reward"] = lambda outcome, task: program.family.reward(outcome, task) - 1
        return family

    monkeypatch.setattr(training, "family_with", family_with)
    refined, document = refine(toy, replace(SMALL, options={"toll": 1.0}), 1, 3)
    check_keys("refinement", document)
    assert document["options"] == refined.about["refined"]["options"] == {"toll": 1.0}
    for entry, usual in zip(document["seeds"], whole[1]["seeds"], strict=True):
        assert entry["returns_before"] == usual["returns_before"]
        assert entry["course"][0] == pytest.approx(usual["course"][0] - 20, abs=1e-2)


def test_an_agent_that_finds_its_codes_is_refused(toy):
    program = replace(toy.program, agent=replace(toy.program.agent, tuned=True))
    with pytest.raises(UsageError, match="finds its codes from experience"):
        refine(replace(toy, program=program), SMALL)


def test_a_policy_that_becomes_infinite_ends_it(toy):
    with pytest.raises(RunError, match="not finite after iteration 2; try a smaller --divergence"):
        refine(toy, Refinement(12, Ppo(4, batch=40, lr=math.inf)), 1)
