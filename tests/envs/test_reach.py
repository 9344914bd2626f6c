"""Metaworld-Reach against the whole scene of the installed `metaworld`, stepped by plain MuJoCo.

Meta-World's own environment cannot be made with MuJoCo 3.17, so its parts around the scene (the hand led by a mocap
body, observations, rewards) are transcribed here in NumPy.
"""

from __future__ import annotations

import importlib.util
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from brax.envs import get_environment
from brax.envs.wrappers.training import wrap

from ear_jax.cli.main import main
from ear_jax.envs import FAMILIES, make_family
from ear_jax.envs.validation import check_class, check_family
from ear_jax.errors import RunError
from ear_jax.physics import sawyer
from ear_jax.physics.sawyer import load_arm, reach_model_path
from ear_jax.presets import preset_config
from ear_jax.runs.training import make_program
from tests.helpers.runs import tiny_config, words

STEPS = 100


@pytest.fixture(scope="module")
def reach():
    return make_family("reach", "native")


def whole_scene() -> mujoco.MjModel:
    """Returns the scene with table, walls, puck and meshes, and the weld as Meta-World sets it."""
    model = mujoco.MjSpec.from_file(str(reach_model_path())).compile()
    model.eq_data[0, :11] = [0, 0, 0, 0, 0, 0, -1, 0, 0, 0, 5]
    return model


def play_scene(actions: np.ndarray) -> list[SimpleNamespace]:
    """Returns Meta-World's observations at the start and after each action [steps, 4]."""
    model = whole_scene()
    data, seen = mujoco.MjData(model), []
    data.mocap_quat[0] = (1, 0, 1, 0)

    def look() -> None:
        mujoco.mj_forward(model, data)
        right, left = (data.body(claw).xpos for claw in ("rightclaw", "leftclaw"))
        tips = [data.site(f"{side}EndEffector").xpos for side in ("right", "left")]
        opening = np.clip(np.linalg.norm(right - left) / 0.1, 0, 1)
        obs = np.append(data.body("hand").xpos, opening)
        seen.append(SimpleNamespace(qpos=data.qpos[:9].copy(), obs=obs, tcp=np.mean(tips, axis=0)))

    for _ in range(50):
        data.mocap_pos[0], data.ctrl[:] = (0, 0.6, 0.2), (-1, 1)
        mujoco.mj_step(model, data, 5)
    look()
    for action in actions:
        led = data.mocap_pos[0] + action[:3] * 0.01
        data.mocap_pos[0] = np.clip(led, (-0.5, 0.4, 0.05), (0.5, 1, 0.5))
        data.ctrl[:] = action[3], -action[3]
        mujoco.mj_step(model, data, 5)
        look()
    return seen


def expected_reward(tcp: np.ndarray, goal: np.ndarray) -> float:
    """reach-v3: 10 × tolerance(distance, bounds (0, 0.05), margin, sigmoid "long_tail" worth 0.1 at the margin)."""
    past = max(np.linalg.norm(tcp - goal) - 0.05, 0) / np.linalg.norm(np.array((0, 0.6, 0.2)) - goal)
    return 10 / ((past * np.sqrt(1 / 0.1 - 1)) ** 2 + 1)


def play(family, actions: np.ndarray):
    """Plays the same through the family; returns its start and the states [steps] after it."""
    task = {name: value[0] for name, value in family.training_tasks().params.items()}
    state = family.start(jax.random.key(0), task)

    def step(state, action):
        state = family.step(state, action)
        return state, state

    return state, jax.jit(lambda state, actions: jax.lax.scan(step, state, actions)[1])(state, jnp.asarray(actions))


KINDS = {
    "random": np.random.default_rng(0).uniform(-1, 1, (STEPS, 4)),
    "into a corner": np.tile([1.0, 1.0, -1.0, 1.0], (STEPS, 1)),
    "and another": np.tile([-1.0, -0.5, 1.0, -1.0], (STEPS, 1)),
}


@pytest.mark.parametrize("kind", KINDS)
def test_steps_equal_the_whole_scene(reach, kind):
    """The only difference is float32 between steps: measured at worst 3e-7 m."""
    seen = play_scene(KINDS[kind])
    start, after = play(reach, KINDS[kind])
    np.testing.assert_allclose(start.obs, seen[0].obs, atol=2e-6)
    np.testing.assert_allclose(after.obs, [one.obs for one in seen[1:]], atol=2e-6)
    tips = np.stack([after.metrics[axis] for axis in "xyz"], axis=1)
    np.testing.assert_allclose(tips, [one.tcp for one in seen[1:]], atol=2e-6)
    print(f"{kind}: worst {np.abs(tips - [one.tcp for one in seen[1:]]).max():.1e} m")
    assert not after.done.any()
    for task in reach.training_tasks().tasks:
        params = {name: jnp.float32(value) for name, value in task.params.items()}
        goal = np.array([task.params[axis] for axis in "xyz"])
        rewards = jax.vmap(reach.reward, (0, None))(after.metrics, params)
        np.testing.assert_allclose(rewards, [expected_reward(one.tcp, goal) for one in seen[1:]], atol=2e-4)


def test_the_arm_alone_moves_as_in_the_scene():
    """C MuJoCo steps both without float32 between steps, on a path that touches nothing."""
    model = load_arm()
    assert (model.nbody, model.nq, model.nv, model.nu, model.nmocap, model.nmesh) == (12, 9, 9, 2, 1, 0)
    data, actions = mujoco.MjData(model), KINDS["random"]
    for _ in range(50):
        data.mocap_pos[0], data.ctrl[:] = (0, 0.6, 0.2), (-1, 1)
        mujoco.mj_step(model, data, 5)
    for action, there in zip(actions, play_scene(actions)[1:], strict=True):
        led = data.mocap_pos[0] + action[:3] * 0.01
        data.mocap_pos[0] = np.clip(led, (-0.5, 0.4, 0.05), (0.5, 1, 0.5))
        data.ctrl[:] = action[3], -action[3]
        mujoco.mj_step(model, data, 5)
        np.testing.assert_allclose(data.qpos, there.qpos, atol=1e-12)


def test_goals_lie_in_meta_worlds_box_and_are_named_by_their_angle(reach):
    tasks = reach.training_tasks()
    goals = np.stack([tasks.params[axis] for axis in "xyz"], axis=1)
    assert (goals >= np.array((-0.1, 0.8, 0.05)) - 1e-6).all()
    assert (goals <= np.array((0.1, 0.9, 0.3)) + 1e-6).all()
    at_goals = dict(zip("xyz", goals.T, strict=True))
    np.testing.assert_allclose(reach.achieved(at_goals, at_goals), tasks.targets, atol=1e-4)
    right, up = reach.parse_task("0").params, reach.parse_task("90").params
    assert (right["x"], right["z"], up["x"], up["z"]) == pytest.approx((0.1, 0.175, 0, 0.3))


def test_at_the_goal_the_reward_is_full(reach):
    params = reach.parse_task("90").params
    for away, reward in ((0, 10), (0.05, 10), (0.05 + params["margin"], 1)):
        outcome = {axis: jnp.float32(params[axis]) for axis in "xyz"} | {"y": jnp.float32(params["y"] - away)}
        assert float(reach.reward(outcome, params)) == pytest.approx(reward, rel=1e-4)


def test_the_agent_sees_two_steps(reach):
    """Meta-World shows two; a recurrent agent sees more."""
    shown = {("paper", "ear"): 2, ("fast", "onehot"): 2, ("smoke", "ear"): 2, ("fast", "ear-rnn"): 8}
    for (preset, agent), steps in shown.items():
        family = make_program(preset_config("reach", preset, agent)).family
        assert (family.history, family.observation_size) == (steps, 4 * steps)
    family = make_program(preset_config("reach", "smoke")).family
    start, after = play(family, KINDS["random"])
    np.testing.assert_array_equal(start.obs[:4], start.obs[4:])
    np.testing.assert_array_equal(after.obs[1:, :4], after.obs[:-1, 4:])


def test_passes_what_a_users_family_must(reach):
    check_class(FAMILIES["reach"], "reach")
    check_family(reach)


def test_is_a_brax_environment_by_name():
    """Under Brax's own wrappers, past the end of an episode."""
    env = wrap(get_environment("ear_reach", engine="native"), episode_length=3)
    state = start = jax.jit(env.reset)(jax.random.split(jax.random.PRNGKey(0), 2))  # Brax takes legacy keys only
    step, action = jax.jit(env.step), jnp.ones((2, env.action_size))
    for _ in range(3):
        state = step(state, action)
    assert state.done.all()
    np.testing.assert_array_equal(state.obs, start.obs)
    assert (step(state, action).obs[:, :3] != start.obs[:, :3]).any()


@pytest.mark.slow
def test_mjx_follows_c_within_measured_tolerance(reach):
    """The hand's path over 100 steps: measured at worst 2.3e-4 m, and 1.7e-3 m into a corner.

    C adds J̇q̇ to the weld's reference acceleration, MJX does not.
    """
    family = make_family("reach", "mjx")
    # Without this option JAX 0.10 recomputes MJX's chain of links many times over; 0.12 does not have it.
    options = {"xla_cpu_use_fusion_emitters": False} if jax.__version_info__ < (0, 12) else {}
    for kind, worst in (("random", 1e-3), ("into a corner", 7e-3)):
        _, native = play(reach, KINDS[kind])
        task = {name: value[0] for name, value in family.training_tasks().params.items()}
        state, error = family.start(jax.random.key(0), task), []
        step = jax.jit(family.step, compiler_options=options)
        for index, action in enumerate(KINDS[kind]):
            state = step(state, jnp.asarray(action))
            error.append(np.abs(state.obs[:3] - native.obs[index, :3]).max())
        print(f"{kind}: mean {np.mean(error):.1e}, worst {np.max(error):.1e} m")
        assert np.max(error) < worst


@pytest.mark.slow
def test_trains_by_the_command_line(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    config = tiny_config(family="reach", tasks=("0", "36"))
    assert main([*words(config), "--out", "run"]) == 0
    capsys.readouterr()
    assert main(["evaluate", "run", "--episodes", "1"]) == 0
    assert "goal-36" in capsys.readouterr().out


def test_without_metaworld_one_line_says_what_to_install(monkeypatch, capsys):
    find_spec = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "metaworld" else find_spec(name))
    line = "the arm comes from the 'metaworld' package, which is not installed: pip install 'ear-jax[reach]'"
    assert main(["train", "reach"]) == 1
    assert line in capsys.readouterr().err
    assert main(["families"]) == 0
    assert f"reach is not available here: {line}" in capsys.readouterr().out


def test_a_metaworld_without_the_scene_is_told_in_one_line(monkeypatch, tmp_path):
    monkeypatch.setattr(sawyer, "package_directory", lambda name: tmp_path)
    with pytest.raises(RunError, match=r"the installed 'metaworld' has no sawyer_reach_v3\.xml: pip install"):
        sawyer.reach_model_path()
