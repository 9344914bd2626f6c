"""Time limits, terminations, true resets, and one bad environment among good ones."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ear_jax.embeddings.evaluate import play
from ear_jax.envs.batched_env import BatchedEnv
from ear_jax.envs.halfcheetah_vel import HalfCheetahVel
from ear_jax.learning.rollout import rollout
from tests.helpers.probe import Slider


@pytest.fixture(scope="module")
def slider() -> Slider:
    return Slider("native")


def roll(family, env_states, actions):
    """Plays open-loop actions [steps, rows, envs, act] and returns every transition."""
    return jax.jit(lambda c, a: rollout(BatchedEnv(family), lambda obs, noise: noise, c, a, lambda t: t))(
        env_states, actions
    )


def test_time_limit_truncates_and_is_no_termination(slider):
    env_states = BatchedEnv(slider).start(jax.random.key(0), slider.training_tasks().params, 3)
    _, steps = roll(slider, env_states, jnp.zeros((9, 2, 3, 1)))
    assert not steps.terminated.any()
    np.testing.assert_array_equal(steps.truncated[:, 0, 0], [False, False, False, True] * 2 + [False])


def test_next_obs_is_the_state_reached_and_obs_after_it_a_fresh_start(slider):
    env_states = BatchedEnv(slider).start(jax.random.key(0), slider.training_tasks().params, 3)
    _, steps = roll(slider, env_states, jnp.ones((9, 2, 3, 1)))
    np.testing.assert_array_equal(steps.next_obs[:3], steps.obs[1:4])
    assert (np.asarray(steps.next_obs[3, ..., 1]) > 0.03).all(), "four steps of pushing leave it moving"
    np.testing.assert_array_equal(steps.obs[4, ..., 1], 0)


def test_resets_differ_between_environments_and_episodes(slider):
    env_states = BatchedEnv(slider).start(jax.random.key(0), slider.training_tasks().params, 3)
    _, steps = roll(slider, env_states, jnp.zeros((12, 2, 3, 1)))
    starts = np.asarray(steps.obs[::4, ..., 0]).ravel()
    assert len(np.unique(starts)) == starts.size == 18


def test_termination_ends_the_episode_at_once(slider):
    env_states = BatchedEnv(slider).start(jax.random.key(0), slider.training_tasks().params, 1)
    far = env_states.state.pipeline_state
    far = far.replace(qpos=far.qpos.at[0].set(5.0))
    env_states = env_states.replace(state=env_states.state.replace(pipeline_state=far))
    after, steps = roll(slider, env_states, jnp.zeros((1, 2, 1, 1)))
    np.testing.assert_array_equal(steps.terminated[0, :, 0], [True, False])
    np.testing.assert_array_equal(after.steps[:, 0], [0, 1])
    assert steps.next_obs[0, 0, 0, 0] == 5.0, "the final observation is kept"
    assert after.state.obs[0, 0, 0] < 2, "and the next episode starts elsewhere"


def test_a_bad_environment_resets_alone(slider):
    env_states = BatchedEnv(slider).start(jax.random.key(0), slider.training_tasks().params, 2)
    bad = env_states.state.pipeline_state
    bad = bad.replace(qvel=bad.qvel.at[1, 0].set(jnp.nan))
    broken = env_states.replace(state=env_states.state.replace(pipeline_state=bad))
    actions = jax.random.uniform(jax.random.key(1), (8, 2, 2, 1))
    _, clean = roll(slider, env_states, actions)
    _, steps = roll(slider, broken, actions)
    np.testing.assert_array_equal(steps.valid[:, 1, 0], [False] + [True] * 7)
    assert np.asarray(steps.valid).sum() == 31
    assert not (steps.terminated | steps.truncated)[0].any()
    for row, env in ((0, 0), (0, 1), (1, 1)):
        np.testing.assert_array_equal(steps.next_obs[:, row, env], clean.next_obs[:, row, env])


def test_staggered_clocks_are_spread_and_within_an_episode():
    family = HalfCheetahVel("native")
    env_states = BatchedEnv(family).start(jax.random.key(0), family.training_tasks().params, 8, stagger=True)
    assert env_states.steps.min() >= 0
    assert env_states.steps.max() < 200
    assert len(np.unique(env_states.steps)) > 40


def test_family_is_a_brax_environment():
    from brax.envs import Env

    family = HalfCheetahVel("native")
    assert isinstance(family, Env)
    assert (family.observation_size, family.action_size, family.backend) == (17, 6, "native")
    state = jax.jit(family.reset)(jax.random.key(0))
    after = jax.jit(family.step)(state, jnp.full(6, 0.5))
    velocity = float(after.pipeline_state.qpos[0] - state.pipeline_state.qpos[0]) / 0.05
    assert float(after.reward) == pytest.approx(-abs(velocity - 1) - 0.1 * 6 * 0.25, abs=1e-5)
    assert float(after.metrics["velocity"]) == pytest.approx(velocity, abs=1e-6)


def test_play_counts_the_first_episode_only(slider):
    """With μ = 0 the mass stands still: each of the 4 steps has the reward −0.25."""
    agent = type("Still", (), {"distribution": staticmethod(lambda policy, code, obs: still)})
    from ear_jax.agents.tanh_gaussian import Gaussian

    still = Gaussian(jnp.zeros(1), jnp.zeros(1))
    tasks = slider.training_tasks().params
    episodes = play(slider, agent, None, jnp.zeros((2, 1)), tasks, jax.random.key(0), 3)
    np.testing.assert_allclose(episodes.returns, -1.0)
    np.testing.assert_array_equal(episodes.lengths, 4)


def test_play_stops_at_termination():
    class Doomed(Slider):
        def terminated(self, physics):
            return jnp.ones((), bool)

    from ear_jax.agents.tanh_gaussian import Gaussian

    still = Gaussian(jnp.zeros(1), jnp.zeros(1))
    agent = type("Still", (), {"distribution": staticmethod(lambda policy, code, obs: still)})
    family = Doomed("native")
    episodes = play(family, agent, None, jnp.zeros((2, 1)), family.training_tasks().params, jax.random.key(0), 3)
    np.testing.assert_allclose(episodes.returns, -0.25)
    np.testing.assert_array_equal(episodes.lengths, 1)
    np.testing.assert_allclose(episodes.late["action"], 0.0)
