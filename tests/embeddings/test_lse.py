"""Periodicity and main directions of signals with known answers."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from ear_jax.embeddings.lse import analyse, autocorrelation, first_peak, lse, principal_components, record_signals
from ear_jax.errors import UsageError
from ear_jax.runs.trained import load
from tests.helpers.documented import check_keys

STEPS = np.arange(120)


def test_a_circle_has_two_equal_directions_and_its_period():
    """Two of five channels, 20 steps a turn."""
    phase = 2 * np.pi * STEPS / 20
    signal = np.zeros((120, 5))
    signal[:, 1], signal[:, 3] = 3 + np.cos(phase), np.sin(phase)
    found = analyse(signal)
    assert found.period == 20
    assert found.peak == pytest.approx(1, abs=1e-9)
    np.testing.assert_allclose(found.explained, [0.5, 0.5], atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(found.path, axis=1), 1, atol=1e-9)


def test_explained_variance_of_independent_channels():
    signal = np.zeros((4, 3))
    signal[:, 0], signal[:, 2] = [2, 2, -2, -2], [1, -1, 1, -1]  # variances 4 and 1
    np.testing.assert_allclose(principal_components(signal)[1], [0.8, 0.2], atol=1e-12)


def test_noise_repeats_less_than_a_gait():
    noise = np.random.default_rng(0).normal(size=(120, 5))
    assert analyse(noise).peak < 0.3


def test_what_only_drifts_has_no_period():
    ramp = STEPS[:, None].astype(float)
    assert first_peak(autocorrelation(ramp)) == 0
    assert analyse(np.ones((120, 2))).peak == 0


def gait(period: float, noise: float, seed: int, others: tuple[tuple[float, float], ...] = ()) -> np.ndarray:
    """Returns a signal of 150 steps and three channels with a period, and further ones as (period, amplitude)."""
    rng, steps = np.random.default_rng(seed), np.arange(150)[:, None]
    phases = np.array([0.0, 1.0, 2.5])
    parts = [amplitude * np.sin(2 * np.pi * steps / each + phases) for each, amplitude in ((period, 1.0), *others)]
    return sum(parts) + noise * rng.normal(size=(150, 3))


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(("period", "noise"), [(6, 0.1), (6.4, 0.1), (13, 0.2), (20, 0.3), (30, 0.1)])
def test_a_period_is_no_multiple_of_itself(period, noise, seed):
    assert abs(analyse(gait(period, noise, seed)).period - period) <= 1


def test_a_pattern_that_repeats_only_at_every_other_beat_has_the_longer_period():
    """The short part alone repeats after 6 steps, but half of the signal does not."""
    assert analyse(gait(6, 0.05, 0, ((12, 1.0),))).period == 12


def test_a_gait_is_told_of():
    trained = load(Path("pretrained:halfcheetah-vel"))
    document = lse(trained, "vel-6", 0)
    check_keys("lse", document)
    assert 0 < document["seeds"][0]["lse"]["period"] < 1


def test_an_agent_without_an_lse_is_refused():
    program = SimpleNamespace(agent=SimpleNamespace(embed=None), config=SimpleNamespace(agent="multihead"))
    with pytest.raises(UsageError, match="agent multihead has no latent sensory embedding"):
        record_signals(SimpleNamespace(program=program), "vel-1", 0)


@pytest.mark.parametrize("highest", [0.9605, 0.99, 1.0])
def test_the_first_of_almost_equal_peaks_is_the_period(highest):
    """The curve of a trained cheetah, whose second peak is higher than its first."""
    curve = np.tile([0.94, 0.2, -0.3, -0.28, -0.3, 0.2], 8)
    curve[0], curve[12] = 1, highest
    assert first_peak(curve) == 6
