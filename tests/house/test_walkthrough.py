"""The walk-through of docs/extending.md: its file is a method that trains."""

from __future__ import annotations

import re
import sys
import types
from collections.abc import Iterator
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from ear_jax.methods import METHODS
from tests.helpers.bandit import bandit_program, begin, played, train_on

DOCUMENT = Path(__file__).parents[2] / "docs" / "extending.md"


@pytest.fixture(scope="module")
def walkthrough() -> Iterator[types.ModuleType]:
    (block,) = re.findall(r"^```python\n(.*?)^```$", DOCUMENT.read_text(), re.MULTILINE | re.DOTALL)
    module = sys.modules["ear_c51"] = types.ModuleType("ear_c51")
    exec(compile(block, str(DOCUMENT), "exec"), vars(module))
    yield module
    del sys.modules["ear_c51"]


def test_a_categorical_target_keeps_mass_and_mean(walkthrough):
    """Bins 0.2 apart: all mass at 1.0, moved to 0.5 + 0.9 · 1.0 = 1.4, a bin; or to 1.5, half way between two."""
    bins = walkthrough.BINS
    logits = jnp.where(jnp.arange(101) == jnp.argmin(jnp.abs(bins - 1.0)), 50.0, 0.0)[None]
    for reward in (0.5, 0.6):
        masses = walkthrough.target(logits, 1.0, lambda value, reward=reward: reward + 0.9 * value)
        assert float(masses.sum()) == pytest.approx(1, abs=1e-5)
        assert float(masses @ bins) == pytest.approx(reward + 0.9, abs=1e-4)
        assert int((masses > 0.01).sum()) == {0.5: 1, 0.6: 2}[reward]


@pytest.mark.slow
def test_it_solves_the_bandit(walkthrough, monkeypatch):
    monkeypatch.setitem(METHODS, "ear-c51", walkthrough.METHOD)
    program = bandit_program("ear-c51")
    state = train_on(program, begin(program), 20)
    episodes = played(program, state.learner.policy, 4)
    np.testing.assert_allclose(episodes.late["action"], [[-0.5] * 4, [0.5] * 4], atol=0.1)
