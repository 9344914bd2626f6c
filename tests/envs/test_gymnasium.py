"""Families in Gymnasium: its own checker, the batch against the single environment, and trainers of others."""

from __future__ import annotations

import importlib
import subprocess
import sys

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

from ear_jax.envs import FAMILIES
from ear_jax.envs.as_gymnasium import FamilyVectorEnv
from ear_jax.errors import RunError, UsageError
from ear_jax.gymnasium_ids import gymnasium_id
from tests.helpers.probe import Bandit, Slider

SLIDER = "slider"


@pytest.fixture(autouse=True)
def _slider(monkeypatch):
    """Adds a family to those that ship."""
    monkeypatch.setitem(FAMILIES, SLIDER, Slider)


def test_every_family_has_an_id():
    ids = {gymnasium_id(name) for name in FAMILIES if name != SLIDER}
    assert ids <= set(gymnasium.registry)
    assert {"ear_jax/HalfCheetahVel-v0", "ear_jax/AntDir-v0", "ear_jax/HalfCheetahRunJump-v0"} <= ids


@pytest.mark.filterwarnings("ignore:.*Box observation space.*infinity")  # as in Gymnasium's own robots
@pytest.mark.filterwarnings("ignore:.*not within the observation space")
def test_gymnasiums_checker_accepts_one_robot():
    env = gymnasium.make("ear_jax/Family-v0", family=SLIDER)
    check_env(env.unwrapped, skip_render_check=True)
    assert env.observation_space.shape == (2,)


def test_a_batch_deals_tasks_in_turn_and_shows_them():
    envs = gymnasium.make_vec("ear_jax/Family-v0", num_envs=4, family=SLIDER)
    assert isinstance(envs, FamilyVectorEnv)
    with pytest.raises(gymnasium.error.ResetNeeded, match="call reset before step"):
        envs.step(np.zeros((4, 1), np.float32))
    assert envs.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    assert envs.task_names == ["-0.5", "0.5", "-0.5", "0.5"]
    obs, infos = envs.reset(seed=3)
    assert infos == {}
    assert obs in envs.observation_space
    np.testing.assert_array_equal(obs[:, 2:], [[1, 0], [0, 1]] * 2)
    _, rewards, *_, infos = envs.step(np.full((4, 1), 0.5, np.float32))
    np.testing.assert_allclose(rewards, [-1, 0, -1, 0], atol=1e-6)  # −(a − a*)²
    np.testing.assert_allclose(infos["action"], 0.5)


def test_an_episode_that_ends_starts_again_and_keeps_the_state_it_reached():
    """Four steps are the time limit: the last state is shown beside the new start."""
    envs = FamilyVectorEnv(SLIDER, 2, ["0.5"])
    first, _ = envs.reset(seed=0)
    states = [envs.step(np.ones((2, 1), np.float32)) for _ in range(4)]
    for obs, _, terminated, truncated, infos in states[:3]:
        assert not (terminated | truncated).any()
        assert "final_obs" not in infos
        np.testing.assert_array_less(first[:, 0], obs[:, 0])
    obs, _, terminated, truncated, infos = states[3]
    assert truncated.all()
    assert not terminated.any()
    reached = np.stack(infos["final_obs"])
    np.testing.assert_allclose(reached[:, 1], 4 * states[0][0][:, 1], rtol=1e-5)  # speed grows evenly
    np.testing.assert_array_equal(obs[:, 1], 0)
    assert (obs[:, 0] != first[:, 0]).all()


def test_equal_seeds_give_equal_episodes():
    envs = FamilyVectorEnv(SLIDER, 2)
    runs = [envs.reset(seed=seed)[0] for seed in (1, 1, 2)]
    np.testing.assert_array_equal(runs[0], runs[1])
    assert (runs[0] != runs[2])[:, 0].all()


def test_a_failure_is_a_termination_and_gymnasium_counts_its_episode(monkeypatch):
    monkeypatch.setitem(FAMILIES, SLIDER, Bandit)  # whose episodes fail after one step
    envs = gymnasium.wrappers.vector.RecordEpisodeStatistics(FamilyVectorEnv(SLIDER, 2))
    envs.reset(seed=0)
    _, _, terminated, truncated, infos = envs.step(np.zeros((2, 1), np.float32))
    assert terminated.all()
    assert not truncated.any()
    assert infos["_final_obs"].all()
    np.testing.assert_allclose(infos["episode"]["r"], [-0.25, -0.25])
    np.testing.assert_array_equal(infos["episode"]["l"], [1, 1])


def test_numbers_that_are_not_finite_end_the_episode_without_a_reward():
    envs = FamilyVectorEnv(SLIDER, 2)
    obs, _ = envs.reset(seed=1)
    after, rewards, terminated, truncated, infos = envs.step(np.array([[np.nan], [0.0]], np.float32))
    assert (truncated.tolist(), terminated.tolist(), infos["invalid"].tolist()) == (
        [True, False],
        [False] * 2,
        [True, False],
    )
    assert rewards[0] == 0
    assert np.isfinite(after).all()
    np.testing.assert_array_equal(infos["final_obs"][0], obs[0])


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        ({"num_envs": 1}, "num_envs=1 is too few for 2 tasks; take 2"),
        ({"num_envs": 2, "tasks": "0.5"}, "must be a list of names"),
        ({"num_envs": 2, "tasks": [2]}, "a task is named by text, as in '2', not by 2"),
        ({"num_envs": 2, "family": "hoper-vel"}, "did you mean 'hopper-vel'"),
    ],
)
def test_mistakes_are_told(arguments, complaint):
    with pytest.raises(UsageError, match=complaint):
        gymnasium.make_vec("ear_jax/Family-v0", **{"family": SLIDER, **arguments})


def test_actions_of_another_shape_are_refused():
    envs = gymnasium.make_vec("ear_jax/Family-v0", family=SLIDER, num_envs=2)
    envs.reset(seed=0)
    with pytest.raises(UsageError, match=r"actions must have shape \(2, 1\), but have \(2, 3\)"):
        envs.step(np.zeros((2, 3)))


@pytest.mark.parametrize("imports", ["import ear_jax, gymnasium", "import gymnasium, ear_jax"])
def test_names_are_there_in_either_order_and_cost_no_import_of_jax(imports):
    code = f"{imports}, sys; gymnasium.spec('ear_jax/AntDir-v0'); print('jax' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("False\n", "")


def test_importing_ear_jax_imports_no_gymnasium():
    code = "import ear_jax, sys; print('gymnasium' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"


def test_stable_baselines3_that_is_absent_is_one_line(monkeypatch):
    monkeypatch.setitem(sys.modules, "stable_baselines3", None)
    monkeypatch.delitem(sys.modules, "ear_jax.envs.as_sb3", raising=False)
    with pytest.raises(RunError, match=r"^Stable-Baselines3 is not installed: pip install stable-baselines3$"):
        importlib.import_module("ear_jax.envs.as_sb3")


@pytest.mark.slow
def test_stable_baselines3_learns_the_bandits_tasks():
    """PPO on 32 sliders learns both tasks' actions from the one-hots."""
    pytest.importorskip("stable_baselines3", reason="needs stable-baselines3")
    from stable_baselines3 import PPO

    from ear_jax.envs.as_sb3 import FamilyVecEnv

    envs = FamilyVecEnv(gymnasium.make_vec("ear_jax/Family-v0", num_envs=32, family=SLIDER))
    model = PPO("MlpPolicy", envs, n_steps=16, batch_size=128, learning_rate=3e-3, gamma=0.5, seed=0, device="cpu")
    model.learn(8_000)
    actions, _ = model.predict(envs.reset(), deterministic=True)
    np.testing.assert_allclose(actions[:2, 0], [-0.5, 0.5], atol=0.2)


@pytest.mark.slow
@pytest.mark.parametrize("family", [name for name in FAMILIES if name != SLIDER])
@pytest.mark.filterwarnings("ignore:.*Box observation space.*infinity")
def test_gymnasiums_checker_accepts_every_family(family):
    if family == "reach":
        pytest.importorskip("metaworld", reason="needs the extra reach")
    check_env(gymnasium.make(gymnasium_id(family)).unwrapped, skip_render_check=True)
