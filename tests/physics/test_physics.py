"""Both engines against a plain loop over `mujoco.mj_step`, and models against Gymnasium's."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from ear_jax.errors import RunError, UsageError
from ear_jax.physics import Physics, choose_engine, make_engine
from ear_jax.physics.models import gymnasium_model_path, load_model
from ear_jax.physics.state import check_state

SUBSTEPS = 5
BODIES = ("bfoot", "torso")


def random_states(model: mujoco.MjModel, count: int, seed: int = 0) -> tuple[np.ndarray, ...]:
    """Returns states as training meets them: each after up to 40 steps of random actions from a random start."""
    rng = np.random.default_rng(seed)
    data = mujoco.MjData(model)
    qpos, qvel, warmstart = (np.zeros((count, size), np.float32) for size in (model.nq, model.nv, model.nv))
    for row in range(count):
        mujoco.mj_resetData(model, data)
        data.qpos += rng.uniform(-0.1, 0.1, model.nq)
        data.qvel += 0.1 * rng.standard_normal(model.nv)
        for _ in range(rng.integers(0, 40)):
            data.ctrl[:] = rng.uniform(-1, 1, model.nu)
            mujoco.mj_step(model, data, SUBSTEPS)
        qpos[row], qvel[row], warmstart[row] = data.qpos, data.qvel, data.qacc_warmstart
    return qpos, qvel, warmstart, rng.uniform(-1, 1, (count, model.nu)).astype(np.float32)


def plain_steps(model: mujoco.MjModel, qpos, qvel, warmstart, action) -> tuple[np.ndarray, ...]:
    """Takes the same step by a loop; positions are of the new state."""
    data = mujoco.MjData(model)
    after = []
    for row in range(len(qpos)):
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:], data.qacc_warmstart[:], data.ctrl[:] = (
            array[row] for array in (qpos, qvel, warmstart, action)
        )
        mujoco.mj_step(model, data, SUBSTEPS)
        qpos_after, qvel_after = data.qpos.copy(), data.qvel.copy()
        warmstart_after = data.qacc_warmstart.copy()
        mujoco.mj_kinematics(model, data)
        positions = np.array([data.body(body).xpos for body in BODIES])
        after.append((qpos_after, qvel_after, warmstart_after, positions))
    return tuple(np.array(field) for field in zip(*after, strict=True))


def step_all(engine, qpos, qvel, warmstart, action):
    return jax.jit(jax.vmap(lambda q, v, w, a: engine.step(Physics(q, v, w), a)))(qpos, qvel, warmstart, action)


@pytest.fixture(scope="module")
def cheetah() -> mujoco.MjModel:
    return load_model("half_cheetah.xml")


def test_native_equals_plain_mujoco(cheetah):
    states = random_states(cheetah, 1000)
    qpos, qvel, warmstart, positions = plain_steps(cheetah, *states)
    motion = step_all(make_engine("native", cheetah, SUBSTEPS, BODIES, (4, 8)), *states)
    np.testing.assert_array_equal(motion.after.qpos, qpos.astype(np.float32))
    np.testing.assert_array_equal(motion.after.qvel, qvel.astype(np.float32))
    np.testing.assert_array_equal(motion.after.warmstart, warmstart.astype(np.float32))
    np.testing.assert_allclose(motion.positions, positions, atol=2e-6)  # MJX's kinematics, in float32
    np.testing.assert_array_equal(motion.before.qpos, states[0])


def test_mjx_equals_plain_mujoco_within_measured_tolerance(cheetah):
    """Measured on 1,000 states: qpos median 1.3e-7, worst 6.4e-6; qvel 4.4e-6 and 5.0e-4; positions 6e-8 and 1.8e-6."""
    states = random_states(cheetah, 300)
    qpos, qvel, _, positions = plain_steps(cheetah, *states)
    motion = step_all(make_engine("mjx", cheetah, SUBSTEPS, BODIES, (4, 8)), *states)
    qpos_error = np.abs(motion.after.qpos - qpos).max(axis=1)
    qvel_error = np.abs(motion.after.qvel - qvel).max(axis=1)
    assert np.median(qpos_error) < 5e-7
    assert np.median(qvel_error) < 2e-5
    assert qpos_error.max() < 3e-5
    assert qvel_error.max() < 3e-3
    assert np.abs(motion.positions - positions).max() < 1e-5


def test_nested_vmap_is_one_native_call(cheetah, monkeypatch):
    engine = make_engine("native", cheetah, SUBSTEPS, (), (4, 8))
    calls = []
    original = engine._step_batch
    monkeypatch.setattr(engine, "_step_batch", lambda *buffers: calls.append(1) or original(*buffers))
    qpos, qvel, warmstart, action = (array.reshape(2, 3, 4, -1) for array in random_states(cheetah, 24))
    step = jax.jit(jax.vmap(jax.vmap(jax.vmap(lambda q, v, w, a: engine.step(Physics(q, v, w), a)))))
    nested = jax.block_until_ready(step(qpos, qvel, warmstart, action))
    assert len(calls) == 1
    alone = engine.step(Physics(*map(jnp.asarray, (qpos[1, 2, 3], qvel[1, 2, 3], warmstart[1, 2, 3]))), action[1, 2, 3])
    np.testing.assert_array_equal(nested.after.qpos[1, 2, 3], alone.after.qpos)


def test_non_finite_state_stays_non_finite_and_alone(cheetah, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    engine = make_engine("native", cheetah, SUBSTEPS, (), (4, 8))
    states = random_states(cheetah, 3)
    clean = step_all(engine, *states)
    states[1][1, 0] = np.nan
    motion = step_all(engine, *states)
    assert not np.isfinite(motion.after.qpos[1]).all()
    for row in (0, 2):
        np.testing.assert_array_equal(motion.after.qpos[row], clean.after.qpos[row])


def test_models_are_gymnasiums():
    """All constants equal those that MuJoCo compiles from the file, but for the margins, which it now adds up."""
    code = """
import mujoco, numpy as np, os, tempfile
from ear_jax.physics.models import gymnasium_model_path, load_model
from ear_jax.physics.state import check_state
for filename in ("half_cheetah.xml", "ant.xml", "hopper.xml", "walker2d.xml"):
    os.chdir(tempfile.mkdtemp())
    ours = load_model(filename)
    assert not os.path.exists("MUJOCO_LOG.TXT"), f"loading {filename} complained"
    theirs = mujoco.MjModel.from_xml_path(str(gymnasium_model_path(filename)))
    names = [name for name in dir(theirs) if isinstance(getattr(theirs, name), np.ndarray)]
    assert len(names) > 100
    assert np.ptp(theirs.geom_margin) == 0, "half of one margin for all is exact"
    ours.geom_margin[:] *= 2
    print(filename, [name for name in names if not np.array_equal(getattr(ours, name), getattr(theirs, name))])
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert [line.split(maxsplit=1) for line in done.stdout.splitlines()] == [
        ["half_cheetah.xml", "[]"],
        ["ant.xml", "[]"],
        ["hopper.xml", "[]"],
        ["walker2d.xml", "[]"],
    ]


def test_model_path_is_inside_gymnasium():
    assert gymnasium_model_path("half_cheetah.xml").is_file()


def test_choice_of_engine(monkeypatch):
    assert choose_engine("auto") == "native"
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    assert choose_engine("auto") == "mjx"
    assert choose_engine("native") == "native"
    with pytest.raises(UsageError, match="did you mean 'native'"):
        choose_engine("natve")


def test_warp_equals_plain_mujoco_or_says_what_to_install(cheetah):
    """Warp's kernels run on the CPU too, slowly; measured there: qpos 3.1e-6 and qvel 1.5e-4 at worst."""
    if importlib.util.find_spec("warp") is None:
        with pytest.raises(RunError, match=r"pip install 'ear-jax\[warp\]'"):
            make_engine("warp", cheetah, SUBSTEPS, BODIES, (4, 8))
        return
    states = random_states(cheetah, 64)
    qpos, qvel, _, positions = plain_steps(cheetah, *states)
    motion = step_all(make_engine("warp", cheetah, SUBSTEPS, BODIES, (4, 8)), *states)
    np.testing.assert_allclose(motion.after.qpos, qpos, atol=3e-5)
    np.testing.assert_allclose(motion.after.qvel, qvel, atol=3e-3)
    np.testing.assert_allclose(motion.positions, positions, atol=1e-5)


def test_threads_that_share_an_engine_do_not_share_their_simulations(cheetah):
    """A step of the batch releases the GIL: without a lock two callers would write into each other's states."""
    engine = make_engine("native", cheetah, SUBSTEPS, (), (4, 8))
    states = random_states(cheetah, 256)
    roll = jax.jit(
        lambda physics, action: (
            jax.lax.scan(lambda now, _: (jax.vmap(engine.step)(now, action).after, None), physics, length=40)[0].qpos
        )
    )
    sides = [(Physics(*states[:3]), sign * states[3]) for sign in (1, -1)]
    alone = [np.asarray(roll(*side)) for side in sides]
    with ThreadPoolExecutor(2) as pool:
        together = list(pool.map(lambda side: np.asarray(roll(*side)), sides * 4))
    for index, qpos in enumerate(together):
        np.testing.assert_array_equal(qpos, alone[index % 2])


ACTUATED = """
<mujoco>
  <option timestep="0.01" gravity="0 0 0">{option}</option>
  <worldbody>
    <body><joint name="s" type="slide" axis="1 0 0" range="-9 9"/><geom size="0.1" mass="1"/></body>
    <body pos="0 0 1"><joint name="t" type="slide" axis="1 0 0" damping="1"/><geom size="0.1" mass="1"/></body>
  </worldbody>
  <actuator>{actuators}</actuator>
</mujoco>
"""
WITH_STATES = {
    "filter": '<general joint="s" dyntype="filter" dynprm="0.5" gainprm="10"/>',
    "two of three": '<general joint="s" dyntype="filterexact" dynprm="0.2" gainprm="3"/><motor joint="t"/>'
    '<intvelocity joint="t" kp="2" actrange="-1 1"/>',
    "muscle": '<muscle joint="s" force="5"/>',
}


def loaded(actuators: str, option: str = "") -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(ACTUATED.format(actuators=actuators, option=option))


@pytest.mark.parametrize(("name", "engine"), [*((name, "native") for name in WITH_STATES), ("two of three", "mjx")])
def test_activations_are_carried_from_step_to_step(name, engine):
    """Twenty steps of one control each end where C MuJoCo does, which keeps all of its state."""
    model, control = loaded(WITH_STATES[name]), 0.8
    data = mujoco.MjData(model)
    physics = Physics(*(jnp.zeros(size) for size in (model.nq, model.nv, model.nv)), act=jnp.zeros(model.na))
    step = jax.jit(make_engine(engine, model, 2, (), (20, 20)).step)
    for _ in range(20):
        data.ctrl[:] = control
        mujoco.mj_step(model, data, 2)
        physics, again = (step(physics, jnp.full(model.nu, control)).after for _ in range(2))
        jax.tree.map(np.testing.assert_array_equal, physics, again)
    assert np.abs(data.act).min() > 0.01
    for field in ("act", "qpos", "qvel"):
        np.testing.assert_allclose(getattr(physics, field), getattr(data, field), rtol=1e-4, atol=1e-6)


def test_a_batch_of_simulations_keeps_its_activations_apart():
    model = loaded(WITH_STATES["filter"])
    step = jax.vmap(make_engine("native", model, 1, (), (4, 8)).step)
    zeros, act = jnp.zeros((3, 2)), jnp.array([[0.0], [0.5], [1.0]])
    after = step(Physics(zeros, zeros, zeros, act=act), jnp.zeros((3, 1))).after
    np.testing.assert_allclose(after.act, act * (1 - 0.01 / 0.5), rtol=1e-6)
    np.testing.assert_allclose(after.qvel[:, 0], 10 * act[:, 0] * 0.01 / 1, rtol=1e-5)


@pytest.mark.parametrize(
    ("actuators", "option", "complaint"),
    [
        ('<motor joint="s" delay="0.05" nsample="6"/>', "", "has delays of actuators or sensors"),
        ('<motor joint="s"/>', '<flag sleep="enable"/>', "has bodies that fall asleep"),
    ],
)
def test_a_model_with_a_hidden_state_is_refused(actuators, option, complaint):
    with pytest.raises(UsageError, match=f"the model {complaint}, which a run cannot carry"):
        make_engine("native", loaded(actuators, option), 1, (), (4, 8))


def test_a_plugin_with_a_state_is_refused():
    """No plugin with a state ships with MuJoCo's wheel for every system, so a stand-in has its numbers."""
    model = SimpleNamespace(nhistory=0, npluginstate=3, opt=SimpleNamespace(enableflags=0))
    with pytest.raises(UsageError, match="has plugins with a state"):
        check_state(model)
