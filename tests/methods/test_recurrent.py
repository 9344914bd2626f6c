"""A cue that is seen once and needed later: only an agent that reads a history can use it."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ear_jax.config import Config, NetworkConfig, SacConfig
from ear_jax.methods import Sizes, make_agent
from tests.helpers.bandit import bandit_program, begin, played, train_on
from tests.helpers.probe import Recall, Slider


def test_an_observation_is_the_last_few_in_their_order_and_the_first_fills_in():
    slider, plain = Slider("native"), Slider("native")
    slider.history = 3
    assert (slider.observation_size, plain.observation_size) == (6, 2)
    step, plain_step = jax.jit(slider.step), jax.jit(plain.step)
    state, single = slider.reset(jax.random.key(0)), plain.reset(jax.random.key(0))
    seen = [single.obs] * 3
    for _ in range(4):
        np.testing.assert_array_equal(state.obs, jnp.concatenate(seen[-3:]))
        state, single = step(state, jnp.ones(1)), plain_step(single, jnp.ones(1))
        seen.append(single.obs)


@pytest.mark.parametrize(
    ("agent", "history", "best"),
    [
        ("ear-rnn", 4, 0.0),
        pytest.param("ear-rnn", 2, -0.125, marks=pytest.mark.slow),
        pytest.param("ear", 1, -0.1875, marks=pytest.mark.slow),
    ],
)
def test_a_cue_is_recalled_as_far_back_as_the_history_goes(agent, history, best):
    """A step without the cue costs 0.25 at best, so the mean over an episode of 4 shows how many steps know it.

    Critics read the history here too: without the cue they could not value an action.
    """
    program = bandit_program(agent, Recall, history, discount=0.5)
    informed = make_agent(Sizes(history, 1, 2), replace(program.config, agent="ear", sac=SacConfig(lte_noise=0.0)))
    knowing = replace(program.agent, critic=informed.critic)
    program = replace(program, agent=knowing, learner=replace(program.learner, agent=knowing))
    state = train_on(program, begin(program), 30)
    assert np.mean(played(program, state.learner.policy, 64).returns) / 4 == pytest.approx(best, abs=0.03)


def test_the_past_is_read_by_the_policy_and_not_by_critics():
    agent = make_agent(
        Sizes(3 * 2, 1, 2), Config("recall", agent="ear-rnn", network=NetworkConfig(8, 1, 1, 1, history=3))
    )
    assert agent.critic
    policy, critic = jax.jit(agent.init_policy)(jax.random.key(0)), jax.jit(agent.critic.init)(jax.random.key(1))
    now = jnp.ones(6)
    past = now.at[0].set(2.0)
    code = agent.codes(policy)[0]
    mean = jax.jit(lambda obs: agent.distribution(policy, code, obs).mean)
    assert (mean(now) != mean(past)).all()
    task = jnp.eye(2)[0]
    of_now, of_past = (agent.critic.predict(critic, obs, jnp.zeros(1), task) for obs in (now, past))
    assert of_now == of_past
