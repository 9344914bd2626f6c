"""Periodicity and main directions of signals with known answers."""

from __future__ import annotations

import numpy as np
import pytest

from ear_jax.embeddings.lse import analyse, autocorrelation, highest_peak, principal_components

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
    assert highest_peak(autocorrelation(ramp)) == 0
    assert analyse(np.ones((120, 2))).peak == 0
