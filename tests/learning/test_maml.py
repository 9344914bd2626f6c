"""Parts of MAML with known answers: advantages, one step within a trust region, one step of tuning."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ear_jax.agents.networks import Params
from ear_jax.agents.tanh_gaussian import Gaussian
from ear_jax.errors import UsageError
from ear_jax.learning import maml
from ear_jax.learning.advantage import advantages, returns_to_go
from ear_jax.learning.maml import MamlLearner, MamlState, Trial, Trials
from ear_jax.learning.trust_region import improve
from ear_jax.methods import Sizes, find_method, make_agent
from ear_jax.presets import preset_config
from ear_jax.runs.training import Program
from tests.helpers.bandit import bandit_program
from tests.helpers.probe import Bandit, Point
from tests.runs.test_failure import Poisoned


def test_returns_to_go_end_with_the_episode():
    reward = jnp.array([[1.0, 1.0], [2.0, jnp.nan], [4.0, 5.0]])
    valid = jnp.array([[True, True], [True, False], [True, False]])
    np.testing.assert_allclose(returns_to_go(reward, valid, 0.5), [[3.0, 1.0], [4.0, 0.0], [4.0, 0.0]])


def test_an_advantage_is_the_reward_that_observation_and_time_did_not_predict():
    """A reward that both predict leaves no advantage; a surprise at one step is all that is left."""
    steps, episodes = 20, 30
    obs = jax.random.normal(jax.random.key(0), (steps, episodes, 1))
    time = jnp.arange(steps)[:, None] * jnp.ones((1, episodes))
    valid = time < 15
    surprise = jnp.zeros((steps, episodes)).at[7, 3].set(10.0)
    found = jax.jit(advantages)(obs, 0.1 * time + surprise, valid, 1e-6, 1.0)
    assert jnp.unravel_index(jnp.argmax(found), found.shape) == (7, 3)
    assert found[7, 3] > 15, "in standard deviations"
    assert jnp.abs(found.at[7, 3].set(0)).max() < 1.5
    assert not found[15:].any()
    assert float(found[:15].mean()) == pytest.approx(0, abs=1e-5)
    assert float(found[:15].std()) == pytest.approx(1, abs=1e-4)


@pytest.mark.parametrize("gae_lambda", [0.0, 0.5, 1.0])
def test_a_smaller_lambda_gives_steps_less_of_what_came_later(gae_lambda):
    """Nobody foresees a reward at one step; k steps before it, (γλ)ᵏ of it are left."""
    steps, episodes, discount = 20, 200, 0.9
    obs = jax.random.normal(jax.random.key(0), (steps, episodes, 1))
    reward = jnp.zeros((steps, episodes)).at[12, 3].set(10.0)
    found = jax.jit(advantages)(obs, reward, jnp.ones((steps, episodes), bool), discount, gae_lambda)
    shares = (found[8:13, 3] / found[12, 3])[::-1]
    np.testing.assert_allclose(shares, (discount * gae_lambda) ** np.arange(5), atol=0.02)
    assert jnp.abs(found[13:]).max() < 0.02 * found[12, 3]


CURVATURE = jnp.diag(jnp.array([4.0, 1.0, 0.25]))


def test_a_step_goes_along_the_natural_gradient_as_far_as_allowed():
    """A linear loss and a quadratic divergence give −F⁻¹g, scaled to the limit; damping is 1 % of F along g."""
    slope = jnp.array([1.0, 1.0, 1.0])

    def measure(where: jax.Array) -> tuple[jax.Array, jax.Array]:
        return where @ slope, 0.5 * (where - 1) @ CURVATURE @ (where - 1)

    def features(where: jax.Array) -> jax.Array:
        return jnp.sqrt(CURVATURE) @ where

    end, metrics = jax.jit(partial(improve, measure, features))(jnp.ones(3), 0.02)
    direction = -jnp.linalg.solve(CURVATURE + 0.01 * 1.75 * jnp.eye(3), slope)
    np.testing.assert_allclose((end - 1) / jnp.linalg.norm(end - 1), direction / jnp.linalg.norm(direction), atol=1e-4)
    assert float(metrics["divergence"]) == pytest.approx(0.02, rel=0.1)
    assert float(metrics["step"]) == 1.0


def test_a_step_too_long_for_the_loss_is_shortened_and_none_is_taken_at_a_minimum():
    def measure(where: jax.Array) -> tuple[jax.Array, jax.Array]:
        return where @ where, 1e-3 * jnp.sum((where - start) ** 2)

    def features(where: jax.Array) -> jax.Array:
        return jnp.sqrt(2e-3) * where

    start = jnp.full(3, 0.1)
    end, metrics = jax.jit(partial(improve, measure, features))(start, 0.02)
    assert 0 < float(metrics["step"]) < 1
    assert end @ end < start @ start
    start = jnp.zeros(3)
    end, metrics = jax.jit(partial(improve, measure, features))(start, 0.02)
    np.testing.assert_array_equal(end, 0)
    assert float(metrics["step"]) == 0


def bandit_learner(envs: int, steps: int, kind: type[Bandit] = Bandit) -> tuple[Program, MamlLearner, Params]:
    """Returns a bandit's program, its learner with other episodes, and an untrained policy."""
    program = bandit_program("maml", kind)
    config = replace(program.config, collect=replace(program.config.collect, envs=envs, steps=steps))
    learner = replace(program.learner, config=config)
    return program, learner, learner.init(jax.random.key(0)).policy


def test_half_the_squared_distance_of_features_curves_as_the_divergence():
    """The Hessian of the divergence in the code, at the code that the trial was played under, is JᵀJ."""
    program, learner, policy = bandit_learner(envs=3, steps=4)
    trials, _, _ = jax.jit(learner.play)(policy, policy["codes"], program.tasks.params, jax.random.key(1))
    trial, origin = jax.tree.map(lambda leaf: leaf[0], trials), policy["codes"][0]
    along = jax.random.normal(jax.random.key(2), origin.shape)

    def on_line(distance: jax.Array) -> tuple[jax.Array, jax.Array]:
        code = origin + distance * along
        return maml.divergence(program.agent, policy, code, trial), maml.features(program.agent, policy, code, trial)

    curvature = jax.hessian(lambda distance: on_line(distance)[0])(0.0)
    slope = jax.jacfwd(lambda distance: on_line(distance)[1])(0.0)
    assert curvature > 0.1
    assert float(jnp.sum(slope**2)) == pytest.approx(float(curvature), rel=1e-4)


def test_tuning_follows_the_policy_gradient_of_a_task_alone():
    """If the mean of N(μ, σ²) is the code, it moves by the mean of α A (u − μ) / σ² over valid steps."""
    program = bandit_program("maml")
    plain = replace(program.agent, distribution=lambda policy, code, obs: Gaussian(code[:1], jnp.full(1, jnp.log(0.5))))
    learner = replace(program.learner, agent=plain)
    raw = jnp.array([[0.5, -1.0], [2.0, 9.0]])
    behaviour = Gaussian(jnp.zeros((2, 2, 1)), jnp.full((2, 2, 1), jnp.log(0.5)))
    valid = jnp.array([[True, True], [True, False]])
    one = Trial(jnp.zeros((2, 2, 1)), raw[..., None], behaviour, jnp.array([[1.0, -1.0], [0.5, 7.0]]), valid)
    both = jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), one)
    both = replace(both, advantage=both.advantage.at[1].multiply(-2))
    tuned = jax.jit(learner.tune)({}, jnp.zeros((2, 1)), both)
    step = 0.01 * (0.5 * 1 + 1 * 1 + 2 * 0.5) / 3 / 0.25
    np.testing.assert_allclose(tuned[:, 0], [step, -2 * step], rtol=1e-5)


def test_a_trial_is_the_first_episode_of_each_environment():
    """The bandit's episode lasts one step."""
    program, learner, policy = bandit_learner(envs=3, steps=4)
    trials, returns, invalid = jax.jit(learner.play)(policy, policy["codes"], program.tasks.params, jax.random.key(1))
    np.testing.assert_array_equal(trials.valid, [[[True] * 3, [False] * 3]] * 2)
    action = jnp.tanh(trials.raw[:, 0, :, 0])
    np.testing.assert_allclose(returns, -((action - jnp.array([[-0.5], [0.5]])) ** 2), atol=1e-5)
    assert invalid == 0


def test_an_update_plays_and_adapts_the_tasks_drawn_alone():
    program = bandit_program("maml")
    config = replace(program.config, meta_batch=1, collect=replace(program.config.collect, envs=64))
    program = replace(program, config=config, learner=replace(program.learner, config=config))
    assert program.env_steps_per_epoch == 64 * 2
    state = program.learner.init(jax.random.key(0))

    @jax.jit
    def epoch(key: jax.Array) -> tuple[Trials, MamlState, dict[str, jax.Array]]:
        _, trials, _ = program.learner.collect(state, None, None, key)  # it starts environments of its own
        return trials, *program.learner.learn(state, trials, key)

    drawn = set()
    for key in jax.random.split(jax.random.key(1), 8):
        trials, after, metrics = epoch(key)
        (task,) = trials.tasks.tolist()
        drawn.add(task)
        assert trials.before.obs.shape == trials.after.obs.shape == (1, 1, 64, 1)
        np.testing.assert_array_equal(after.policy["codes"].any(axis=1), np.arange(2) == task)
        np.testing.assert_array_equal(metrics["finite_updates"], [1, 1])
    assert drawn == {0, 1}


class Breaks(Poisoned):
    """A Slider whose physics breaks in episodes that start past the middle."""

    limit = 0.5


def test_an_episode_that_breaks_counts_until_then_and_spoils_nothing():
    program, learner, policy = bandit_learner(envs=6, steps=8, kind=Breaks)

    @jax.jit
    def tuned(key: jax.Array) -> tuple[Trial, jax.Array, jax.Array, jax.Array]:
        trials, returns, invalid = learner.play(policy, policy["codes"], program.tasks.params, key)
        return trials, returns, invalid, learner.tune(policy, policy["codes"], trials)

    trials, returns, invalid, codes = tuned(jax.random.key(1))
    broken = ~np.asarray(trials.valid)[:, -1]
    assert invalid == broken.sum() > 0
    assert not broken.all()
    np.testing.assert_array_equal(returns == 0, broken)
    assert np.isfinite(codes).all()
    assert codes.any()


@pytest.mark.slow
def test_one_step_of_tuning_takes_a_point_to_its_goal():
    """Before it, no policy knows which of four corners is meant; the best stays near the middle, 0.71 from each."""
    family = Point("native")
    base, tasks = preset_config("halfcheetah-vel", "fast", "maml"), family.training_tasks().params
    config = replace(base, maml=replace(base.maml, inner_lr=0.1), collect=replace(base.collect, steps=100))
    learner = MamlLearner(make_agent(Sizes(2, 2, 4), config), family, tasks, config)

    def epoch(state: MamlState, key: jax.Array) -> tuple[MamlState, dict[str, jax.Array]]:
        _, trials, metrics = learner.collect(state, None, None, key)  # it starts environments of its own
        return learner.learn(state, trials, key)[0], metrics

    _, metrics = jax.lax.scan(epoch, learner.init(jax.random.key(0)), jax.random.split(jax.random.key(2), 10))
    before, after = metrics["return_before"], metrics["return_after"]  # of 50 steps
    assert after[0] == pytest.approx(before[0], abs=1), "untrained, a step changes little"
    assert before[-3:].mean() < -33
    assert after[-3:].mean() > -13


def test_steps_that_cannot_be_halved_and_more_than_one_update_are_refused():
    config = preset_config("halfcheetah-vel", "fast", "maml")
    check = find_method("maml").learner.check
    check(config, 7)  # batches do not matter
    with pytest.raises(UsageError, match="401 is odd"):
        check(replace(config, collect=replace(config.collect, steps=401)), 10)
    with pytest.raises(UsageError, match="one update per epoch"):
        check(replace(config, sac=replace(config.sac, updates=2)), 10)
