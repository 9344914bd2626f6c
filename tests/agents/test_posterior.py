"""The posterior over a code against values worked out by hand."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ear_jax.agents.posterior import Posterior, prior, product
from ear_jax.learning import replay
from ear_jax.learning.replay import Experience, Replay


def test_the_product_of_two_normal_distributions():
    """Of N(1, 1) and N(4, 2): precision 1 + 1/2, and the mean (1 + 2) / 1.5."""
    means, variances = jnp.array([[1.0], [4.0]]), jnp.array([[1.0], [2.0]])
    posterior = product(means, variances, jnp.ones(2, bool))
    assert (float(posterior.mean[0]), float(posterior.variance[0])) == pytest.approx((2.0, 1 / 1.5))
    turned = product(means[::-1], variances[::-1], jnp.ones(2, bool))
    np.testing.assert_allclose(turned.mean, posterior.mean, rtol=1e-6)


def test_invalid_steps_count_for_nothing_and_without_steps_the_prior_stays():
    means, variances = jnp.array([[1.0], [4.0]]), jnp.array([[1.0], [2.0]])
    posterior = product(means, variances, jnp.array([False, True]))
    assert (float(posterior.mean[0]), float(posterior.variance[0])) == pytest.approx((4.0, 2.0))
    nothing = product(means, variances, jnp.zeros(2, bool))
    np.testing.assert_array_equal((nothing.mean, nothing.variance), (prior(1).mean, prior(1).variance))
    infinite = product(means.at[0].set(jnp.nan), variances.at[0].set(jnp.nan), jnp.array([False, True]))
    assert (float(infinite.mean[0]), float(infinite.variance[0])) == pytest.approx((4.0, 2.0))
    grad = jax.grad(lambda means: product(means, variances, jnp.zeros(2, bool)).mean.sum())(means)
    assert np.isfinite(grad).all()


def test_divergence_from_the_prior():
    """KL(N(m, v) ‖ N(0, 1)) = ½ (v + m² − 1 − log v)."""
    assert float(prior(3).kl_to_prior()) == 0
    posterior = Posterior(jnp.array([1.0, 0.0]), jnp.array([1.0, 2.0]))
    assert float(posterior.kl_to_prior()) == pytest.approx(0.5 + 0.5 * (1 - np.log(2)))


def test_a_code_is_drawn_in_standard_deviations_from_the_mean():
    np.testing.assert_allclose(Posterior(jnp.array([1.0]), jnp.array([4.0])).sample(jnp.array([-1.5])), [-2.0])


@pytest.mark.parametrize(("added", "newest"), [(0, None), (2, [1, 1, 0, 0]), (5, [4, 3, 2, 2]), (9, [8, 7, 6, 6])])
def test_the_newest_items_of_a_ring(added, newest):
    """Rings of 4 into which 0, 1, 2, … went, each replacing the oldest; a window of 3."""
    ring = np.zeros(4)
    for item in range(added):
        ring[item % 4] = item
    rings = Experience(*[jnp.array(ring)[None]] * 5)
    items, held = replay.recent(Replay(rings, jnp.array([added])), jnp.arange(1), jnp.array([[0.0, 0.4, 0.7, 0.99]]), 3)
    assert held.all() == held.any() == (newest is not None)
    if newest is not None:
        np.testing.assert_array_equal(items.obs[0], newest)
